/*
 * Warm start: first slacks and multipliers near to those that a guess knows.
 *
 * Newton's step from them tells which inequalities will hold, and which will pull: where it makes a slack or a multiplier
 * negative, the barrier has to begin as high as the square of a share of that, in units of the scaling, else as low as it
 * was for the step. A low barrier holds what it begins with, a higher one lets go of it: the one that has to begin lowest
 * counts.
 */
#include "search.h"

/* Barriers, relative, from which a step is followed; the first is the last one of a usual tolerance. */
static const double levels[] = {RETRAX_LAST_BARRIER * RETRAX_USUAL_TOLERANCE, 1e-7, 1e-5, 1e-3, 1e-2};
/* Share of what slacks or multipliers lack then whose square is the barrier to begin with; a higher one does not fit. */
#define FIRST_BARRIER_SHARE 0.1
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
        const bool never_elastic = retrax_is_never_elastic(phase, i);
        const double multiplier = known[layout->first[RETRAX_ARRAY_LIMIT_MULTIPLIERS] + i];
        const double unit = phase->constraint_scales[retrax_limit_of(layout->problem, i).limit];
        const double k = never_elastic ? 0.0 : unit * unit / (phase->limits.rate * search->penalty_scale);
        const double apart = never_elastic ? -retrax_limit_inside(phase, trajectory, i)
                                  : known[layout->first[RETRAX_ARRAY_SLACKS] + i] - k * multiplier;
        const double more = (sqrt(apart * apart + 4.0 * k * mu) + fabs(apart)) / 2.0;
        const bool asked = ARRAY(LIMIT_WEIGHTS)[i] > 0.0;
        const double slack = asked ? (apart > 0.0 ? more : k * mu / more) : 1.0;
        ARRAY(SLACKS)[i] = slack;
        ARRAY(LIMIT_MULTIPLIERS)[i] = asked ? fmax(mu / slack, never_elastic ? multiplier : 0.0) : 0.0;
        ARRAY(EXCESSES)[i] = 0.0;
        ARRAY(PENALTIES)[i] = INFINITY;
    }
}

/* By how much a slack or a multiplier is below zero after the whole Newton step, in units of its scaling. */
static double negative_part(const retrax_phase *phase, const double *trajectory) {
    const retrax_layout *const layout = phase->layout;
    double negative = 0.0;
    for (retrax_index i = 0; i < layout->count[RETRAX_ARRAY_LIMITS]; i++) {
        const double unit = phase->constraint_scales[retrax_limit_of(layout->problem, i).limit];
        const double slack = ARRAY(SLACKS)[i] + ARRAY(SLACK_STEPS)[i];
        const double multiplier = ARRAY(LIMIT_MULTIPLIERS)[i] + ARRAY(LIMIT_MULTIPLIER_STEPS)[i];
        if (ARRAY(LIMIT_WEIGHTS)[i] > 0.0) {
            negative = retrax_larger(negative, -slack / unit);
            negative = retrax_larger(negative, -multiplier * unit / phase->limits.rate);
        }
    }
    return negative;
}

/* Writes slacks and multipliers of the iterate after the whole Newton step to the trial. */
static void follow(const retrax_search *search) {
    EACH_PHASE(phase) {
        const retrax_layout *const layout = phase->layout;
        const double *const at = search->at + phase->place;
        double *const trajectory = search->trial + phase->place;
        for (retrax_index i = 0; i < layout->count[RETRAX_ARRAY_LIMITS] && phase->knows; i++) {
            ARRAY(SLACKS)[i] = at[layout->first[RETRAX_ARRAY_SLACKS] + i] + at[layout->first[RETRAX_ARRAY_SLACK_STEPS] + i];
            ARRAY(LIMIT_MULTIPLIERS)[i] = at[layout->first[RETRAX_ARRAY_LIMIT_MULTIPLIERS] + i] +
                                          at[layout->first[RETRAX_ARRAY_LIMIT_MULTIPLIER_STEPS] + i];
        }
    }
}

/* Sets the slacks of the guess to the values of its inequalities. */
static void set_guessed_slacks(const retrax_search *search) {
    EACH_PHASE(phase) {
        const retrax_layout *const layout = phase->layout;
        double *const guess = search->first + phase->guess_place;
        for (retrax_index i = 0; i < layout->count[RETRAX_ARRAY_LIMITS] && phase->knows; i++) {
            guess[layout->first[RETRAX_ARRAY_SLACKS] + i] = -search->at[phase->place + layout->first[RETRAX_ARRAY_LIMITS] + i];
        }
    }
}

/* Writes slacks and multipliers of all phases that know some, near to a barrier: to those that the guess knows, or to
 * those that a step from there has led to. */
static void write_all_near(const retrax_search *search, bool led, double barrier) {
    EACH_PHASE(phase) {
        if (phase->knows) {
            write_near(search, phase, led ? search->trial + phase->place : search->first + phase->guess_place, barrier);
        }
    }
}

bool retrax_warm_start(retrax_search *search) {
    double least = INFINITY;
    set_guessed_slacks(search);
    for (size_t i = 0; i < sizeof(levels) / sizeof(levels[0]) && least > levels[i]; i++) {
        write_all_near(search, false, levels[i]);
        retrax_evaluate(search, search->at);
        retrax_newton_step(search, 0.0);
        double negative = 0.0;
        EACH_PHASE(phase) {
            negative = phase->knows ? retrax_larger(negative, negative_part(phase, search->at + phase->place)) : negative;
        }
        const double needed = fmax(FIRST_BARRIER_SHARE * FIRST_BARRIER_SHARE * negative * negative, levels[i]);
        if (search->direction.finite && isfinite(negative) && needed < least) {
            follow(search);
            least = needed;
        }
    }
    if (!(least < FITS)) {
        return false;
    }
    write_all_near(search, true, fmin(least, FITS));
    return true;
}
