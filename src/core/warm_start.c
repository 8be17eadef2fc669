/*
 * Warm start: first slacks and multipliers near to those that a guess knows.
 *
 * Newton's step from them tells which inequalities will hold, and which will pull: where it makes a slack or a multiplier
 * negative, the barrier has to begin as high as the square of a share of that, in natural sizes, else as low as it was for
 * the step. A low barrier holds what it begins with, a higher one lets go of it: the one that has to begin lowest counts.
 */
#include "search.h"

/* Barriers, relative, from which a step is followed; the first is the last one of a usual tolerance. */
static const double levels[] = {1.1028289493045308e-12, 1e-7, 1e-5, 1e-3, 1e-2};
/* Share of what slacks or multipliers lack then whose square is the barrier to begin with; a higher one does not fit. */
#define FOLLOWED 0.1
#define FITS 0.1

/* Writes slacks and multipliers with nu s = mu nearest to those of `known`, which may be negative: s - k nu stays as it
 * is, where k makes them of one unit. Nothing is elastic: an inequality that pulls and does not hold is left so. The
 * slack of a bound that no iterate leaves is -g, and its multiplier the known one. */
static void write_near(const retrax_search *search, const retrax_phase *phase, const double *known, double barrier) {
    const retrax_layout *const layout = phase->layout;
    double *const trajectory = search->at + phase->place;
    const double mu = barrier * phase->limits.rate;
    *ARRAY(BARRIER) = mu;
    for (retrax_index i = 0; i < layout->count[RETRAX_ARRAY_LIMITS]; i++) {
        const bool kept = retrax_is_kept(phase, i);
        const double multiplier = known[layout->first[RETRAX_ARRAY_LIMIT_MULTIPLIERS] + i];
        const double unit = phase->limit_sizes[retrax_limit_of(layout->problem, i).limit];
        const double k = kept ? 0.0 : unit * unit / (phase->limits.rate * search->firm);
        const double apart = kept ? -retrax_limit_inside(phase, trajectory, i)
                                  : known[layout->first[RETRAX_ARRAY_SLACKS] + i] - k * multiplier;
        const double more = (sqrt(apart * apart + 4.0 * k * mu) + fabs(apart)) / 2.0;
        const bool asked = ARRAY(LIMIT_WEIGHTS)[i] > 0.0;
        const double slack = asked ? (apart > 0.0 ? more : k * mu / more) : 1.0;
        ARRAY(SLACKS)[i] = slack;
        ARRAY(LIMIT_MULTIPLIERS)[i] = asked ? fmax(mu / slack, kept ? multiplier : 0.0) : 0.0;
        ARRAY(EXCESSES)[i] = 0.0;
        ARRAY(PENALTIES)[i] = INFINITY;
    }
}

/* Writes slacks and multipliers after the whole Newton step to `led`; returns by how much one of them is below zero, in
 * its natural size. */
static double follow(const retrax_search *search, const retrax_phase *phase, double *led) {
    const retrax_layout *const layout = phase->layout;
    const double *const trajectory = search->at + phase->place;
    double lacks = 0.0;
    for (retrax_index i = 0; i < layout->count[RETRAX_ARRAY_LIMITS]; i++) {
        const double unit = phase->limit_sizes[retrax_limit_of(layout->problem, i).limit];
        const double slack = ARRAY(SLACKS)[i] + ARRAY(SLACK_STEPS)[i];
        const double multiplier = ARRAY(LIMIT_MULTIPLIERS)[i] + ARRAY(LIMIT_MULTIPLIER_STEPS)[i];
        led[layout->first[RETRAX_ARRAY_SLACKS] + i] = slack;
        led[layout->first[RETRAX_ARRAY_LIMIT_MULTIPLIERS] + i] = multiplier;
        if (ARRAY(LIMIT_WEIGHTS)[i] > 0.0) {
            lacks = retrax_larger(lacks, -slack / unit);
            lacks = retrax_larger(lacks, -multiplier * unit / phase->limits.rate);
        }
    }
    return lacks;
}

/* Copies slacks and multipliers. */
static void copy_both(const retrax_layout *layout, const double *from, double *to) {
    const retrax_index count = layout->count[RETRAX_ARRAY_SLACKS];
    const retrax_index slacks = layout->first[RETRAX_ARRAY_SLACKS];
    const retrax_index multipliers = layout->first[RETRAX_ARRAY_LIMIT_MULTIPLIERS];
    retrax_copy(to + slacks, from + slacks, count);
    retrax_copy(to + multipliers, from + multipliers, count);
}

/* The same of all phases that know multipliers. */
static void copy_all(const retrax_search *search, const double *from, double *to) {
    EACH_PHASE(phase) {
        if (phase->knows) {
            copy_both(phase->layout, from + phase->place, to + phase->place);
        }
    }
}

/* Writes slacks and multipliers of all phases that know some, near to a barrier. */
static void write_all_near(const retrax_search *search, const double *known, double barrier) {
    EACH_PHASE(phase) {
        if (phase->knows) {
            write_near(search, phase, known + phase->place, barrier);
        }
    }
}

bool retrax_warm_start(retrax_search *search, double *known) {
    double *const ahead = search->first, *const led = search->trial;
    double least = INFINITY;
    EACH_PHASE(phase) {
        const retrax_layout *const layout = phase->layout;
        for (retrax_index i = 0; i < layout->count[RETRAX_ARRAY_LIMITS] && phase->knows; i++) {
            known[phase->place + layout->first[RETRAX_ARRAY_SLACKS] + i] =
                -search->at[phase->place + layout->first[RETRAX_ARRAY_LIMITS] + i];
        }
    }
    copy_all(search, known, ahead);
    for (size_t i = 0; i < sizeof(levels) / sizeof(levels[0]) && least > levels[i]; i++) {
        write_all_near(search, known, levels[i]);
        retrax_evaluate(search, search->at);
        retrax_newton_step(search, 0.0);
        double lacks = 0.0;
        EACH_PHASE(phase) {
            lacks = phase->knows ? retrax_larger(lacks, follow(search, phase, led + phase->place)) : lacks;
        }
        const double needed = fmax(FOLLOWED * FOLLOWED * lacks * lacks, levels[i]);
        if (search->direction.finite && isfinite(lacks) && needed < least) {
            copy_all(search, led, ahead);
            least = needed;
        }
    }
    if (!(least < FITS)) {
        return false;
    }
    write_all_near(search, ahead, fmin(least, FITS));
    return true;
}
