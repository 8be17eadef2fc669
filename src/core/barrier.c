/*
 * Barrier: the scaling factors of the inequalities, their first slacks, and how the barrier falls and penalties grow.
 *
 * A barrier problem is solved to ten times the barrier, which then is the smaller of a fifth of it and its power 1.5
 * [Waechter, Biegler, On the implementation of an interior-point filter line-search algorithm, Math. Program. 106, 2006].
 * Where a multiplier comes near to the penalty of its excess, the cost counts less instead.
 */
#include "search.h"

#include <float.h>
#include <math.h>

/* An inequality that holds at first by less than this share of its size is elastic. */
#define INSIDE 1e-2
/* The first barrier, in units of the scaling. */
#define FIRST_BARRIER 0.3
/* Factor by which the cost counts less where penalties are too small. */
#define PENALTY_FACTOR 3.0
/* A barrier problem is solved to so many times the barrier; then that falls by a factor, or by a power. */
#define SOLVED 10.0
#define BARRIER_FACTOR 0.2
#define FASTER 1.5
/* A barrier that exceeds the last one by a smaller share is the last. */
#define SAME_BARRIER (4.0 * DBL_EPSILON)
/* Above this barrier, relative, excesses are left whatever their penalty. */
#define TELLS 0.1
/* A step of a smaller fraction jams at the inequalities; with a larger regularisation it is stiff. */
#define JAMMED 1e-3
#define STIFF 1e2
/* A slack that would be less than this share of it stays as its step made it. */
#define LEFT 0.01

static retrax_index limit_of(const retrax_phase *phase, retrax_index i) {
    return retrax_limit_of(phase->layout->problem, i).limit;
}

bool retrax_is_never_elastic(const retrax_phase *phase, retrax_index i) {
    return phase->layout->problem->never_elastic[limit_of(phase, i)] != 0.0;
}

/* The scaling factor of an unknown that an inequality depends on. */
static double size_of_unknown(const retrax_phase *phase, const retrax_limit *of, retrax_index a) {
    const retrax_problem *const problem = phase->layout->problem;
    const retrax_index n = problem->state_size, m = problem->control_size, point = of->block % problem->points;
    if (!retrax_collocates(problem)) {
        return phase->steps.unknowns[a];
    }
    if (a >= 3 * n) {
        return phase->steps.unknowns[n + point * m + a - 3 * n];
    }
    return a < 2 * n ? phase->steps.nodes[a % n] : 0.0; /* no inequality depends on velocities */
}

/* Writes the scaling factors of the inequalities: what a step of the size of the scaling changes them by, or their
 * values where that is next to nothing, as that of a ball where its derivative vanishes. */
static void write_limits(retrax_phase *phase, const double *trajectory) {
    const retrax_layout *const layout = phase->layout;
    const retrax_problem *const problem = layout->problem;
    const retrax_index total = problem->inequalities + problem->node_inequalities;
    for (retrax_index j = 0; j < total; j++) {
        double size = 0.0, value = 0.0;
        for (retrax_index i = 0; i < layout->count[RETRAX_ARRAY_LIMITS]; i++) {
            const retrax_limit of = retrax_limit_of(problem, i);
            double change = 0.0;
            for (retrax_index a = 0; a < of.width && of.limit == j; a++) {
                change += fabs(ARRAY(LIMIT_JACOBIANS)[of.first + a]) * size_of_unknown(phase, &of, a);
            }
            size = retrax_larger(size, change);
            value = of.limit == j ? retrax_larger(value, fabs(ARRAY(LIMITS)[i])) : value;
        }
        size = size > RETRAX_VALUE_SHARE * value ? size : value;
        phase->constraint_scales[j] = size > 0.0 && isfinite(size) ? size : 1.0;
    }
}

double retrax_limit_inside(const retrax_phase *phase, const double *trajectory, retrax_index i) {
    const retrax_layout *const layout = phase->layout;
    const double value = ARRAY(LIMITS)[i], constraint_scale = phase->constraint_scales[limit_of(phase, i)];
    return retrax_is_never_elastic(phase, i) ? fmin(value, -DBL_EPSILON * constraint_scale) : value;
}

/* Writes the slack, multiplier and excess of an inequality on the central path: g + s = t, nu s = zeta t = mu. */
static void write_central(const retrax_phase *phase, double *trajectory, retrax_index i, double penalty) {
    const retrax_layout *const layout = phase->layout;
    const double mu = *ARRAY(BARRIER), g = retrax_limit_inside(phase, trajectory, i);
    double slack = 1.0, multiplier = 0.0, excess = 0.0;
    if (!(ARRAY(LIMIT_WEIGHTS)[i] > 0.0)) {
        penalty = INFINITY;
    } else if (isinf(penalty)) {
        multiplier = mu / (g < 0.0 ? -g : 1.0);
        slack = mu / multiplier;
    } else { /* mu / nu - mu / (rho - nu) = -g has one solution between 0 and rho */
        const double b = g * penalty - 2.0 * mu, root = sqrt(b * b + 4.0 * g * mu * penalty);
        multiplier = b < 0.0 ? 2.0 * mu * penalty / (root - b) : (b + root) / (2.0 * (g == 0.0 ? 0.5 : g));
        slack = mu / multiplier;
        excess = fmax(slack + g, mu / penalty);
    }
    ARRAY(SLACKS)[i] = slack;
    ARRAY(LIMIT_MULTIPLIERS)[i] = multiplier;
    ARRAY(EXCESSES)[i] = excess;
    ARRAY(PENALTIES)[i] = penalty;
}

/* The usual first penalty of an inequality; infinite where no iterate leaves it. */
static double first_penalty(const retrax_search *search, const retrax_phase *phase, retrax_index i) {
    const double unit = phase->limits.rate / phase->constraint_scales[limit_of(phase, i)];
    return retrax_is_never_elastic(phase, i) ? INFINITY : RETRAX_FIRST_PENALTY * unit * search->penalty_scale;
}

void retrax_rest_slacks(const retrax_layout *layout, double *trajectory) {
    for (retrax_index i = 0; i < layout->count[RETRAX_ARRAY_SLACKS]; i++) {
        ARRAY(SLACKS)[i] = 1.0;
        ARRAY(LIMIT_MULTIPLIERS)[i] = ARRAY(EXCESSES)[i] = 0.0;
        ARRAY(PENALTIES)[i] = INFINITY;
    }
    *ARRAY(BARRIER) = 0.0;
}

void retrax_find_limits(retrax_phase *phase, const double *trajectory) {
    const retrax_layout *const layout = phase->layout;
    const double duration = retrax_duration(layout, trajectory);
    phase->limits.rate = phase->steps.cost * (double)layout->problem->steps / duration;
    write_limits(phase, trajectory);
}

void retrax_start_slacks(const retrax_search *search, retrax_phase *phase, double *trajectory) {
    const retrax_layout *const layout = phase->layout;
    retrax_find_limits(phase, trajectory);
    *ARRAY(BARRIER) = FIRST_BARRIER * phase->limits.rate * sqrt(search->penalty_scale);
    for (retrax_index i = 0; i < layout->count[RETRAX_ARRAY_LIMITS]; i++) {
        const double constraint_scale = phase->constraint_scales[limit_of(phase, i)];
        const bool holds = retrax_limit_inside(phase, trajectory, i) < -INSIDE * constraint_scale;
        write_central(phase, trajectory, i, holds ? INFINITY : first_penalty(search, phase, i));
    }
}

/* Whether a phase has inequalities that are not elastic and can be. */
static bool is_not_yet_elastic(const retrax_phase *phase, const double *trajectory) {
    const retrax_layout *const layout = phase->layout;
    for (retrax_index i = 0; i < layout->count[RETRAX_ARRAY_LIMITS]; i++) {
        if (ARRAY(LIMIT_WEIGHTS)[i] > 0.0 && isinf(ARRAY(PENALTIES)[i]) && !retrax_is_never_elastic(phase, i)) {
            return true;
        }
    }
    return false;
}

bool retrax_is_not_yet_elastic(const retrax_search *search) {
    bool found = false;
    EACH_PHASE(phase) { found = found || is_not_yet_elastic(phase, search->at + phase->place); }
    return found;
}

/* Makes all inequalities of a trajectory elastic that can be, on the central path of at least the first barrier. */
static void enter_elastic_mode(const retrax_search *search, const retrax_phase *phase, double *trajectory) {
    const retrax_layout *const layout = phase->layout;
    const double first = FIRST_BARRIER * phase->limits.rate * sqrt(search->penalty_scale);
    *ARRAY(BARRIER) = fmax(*ARRAY(BARRIER), first);
    for (retrax_index i = 0; i < layout->count[RETRAX_ARRAY_LIMITS]; i++) {
        write_central(phase, trajectory, i, fmin(ARRAY(PENALTIES)[i], first_penalty(search, phase, i)));
    }
}

/* Multiplies numbers by a factor. */
static void multiply(double *numbers, double factor, retrax_index count) {
    for (retrax_index i = 0; i < count; i++) {
        numbers[i] *= factor;
    }
}

/* Makes the cost of a trajectory count less: all multipliers grow with the penalties. The barrier does not: it would
 * hold the trajectory far from its inequalities, where the cost, which counts less and less, no longer leads it back. */
static void raise_penalties(const retrax_layout *layout, double *trajectory) {
    static const retrax_array scaled[] = {RETRAX_ARRAY_POINT_COSTATES, RETRAX_ARRAY_COSTATES,
                                          RETRAX_ARRAY_LIMIT_MULTIPLIERS, RETRAX_ARRAY_PENALTIES};
    for (size_t i = 0; i < sizeof(scaled) / sizeof(scaled[0]); i++) {
        multiply(trajectory + layout->first[scaled[i]], PENALTY_FACTOR, layout->count[scaled[i]]);
    }
}

/* What all multipliers, and the unit of the barrier, have grown by with the penalties of any phase. */
static double largest_penalty_growth(const retrax_search *search) {
    double found = 1.0;
    EACH_PHASE(phase) {
        const double *const trajectory = search->at + phase->place;
        const retrax_layout *const layout = phase->layout;
        found = retrax_has_inequalities(layout->problem) ? fmax(found, ARRAY(LIMIT_SURVEY)[RETRAX_LIMIT_PENALTY_GROWTH]) : found;
    }
    return found;
}

/* The barrier of a phase, lower while its problem is solved; penalty_too_small: whether penalties are too small to lower
 * it. */
static double lowered_barrier(const retrax_search *search, const retrax_phase *phase, double penalty_growth,
                              bool *penalty_too_small) {
    const retrax_layout *const layout = phase->layout;
    const double *const trajectory = search->at + phase->place, *const survey = ARRAY(LIMIT_SURVEY);
    const double rate = phase->limits.rate * penalty_growth;
    const double last = RETRAX_LAST_BARRIER * search->options.tolerance * phase->limits.rate / rate;
    double barrier = *ARRAY(BARRIER);
    *penalty_too_small = false;
    for (;;) {
        const double least = survey[RETRAX_LIMIT_LEAST], most = survey[RETRAX_LIMIT_PRODUCT];
        const double centring = retrax_larger(retrax_larger(most - barrier, barrier - least), 0.0);
        const double relative = barrier / rate, enough = fmax(SOLVED * relative, search->options.tolerance);
        if (!(RESIDUAL(search->at, ERROR_WITHOUT_COMPLEMENTARITY) <= enough && centring <= SOLVED * barrier)) {
            return barrier;
        }
        *penalty_too_small = survey[RETRAX_LIMIT_PENALTY_TOO_SMALL] > 0.0 && relative <= TELLS;
        if (*penalty_too_small || !(relative > (1.0 + SAME_BARRIER) * last)) {
            return barrier;
        }
        const double less = fmax(last, fmin(BARRIER_FACTOR * relative, pow(relative, FASTER))) * rate;
        if (!(less < barrier)) {
            return barrier; /* rounding of a rate that is next to zero */
        }
        barrier = less;
    }
}

/* Whether steps jam at inequalities that are not elastic. */
static bool is_stuck(const retrax_search *search) {
    const retrax_direction *const step = &search->direction;
    const bool jams = step->regularisation >= STIFF || search->backtrack * step->alpha_max <= JAMMED || !step->finite;
    return jams && RESIDUAL(search->at, BARRIER_ERROR) > sqrt(search->options.tolerance) && retrax_is_not_yet_elastic(search);
}

/* Lowers the barriers of all phases; penalty_too_small: whether penalties of any are too small. Returns whether one is
 * lower. */
static bool lower_barriers(retrax_search *search, bool *penalty_too_small) {
    const double penalty_growth = largest_penalty_growth(search);
    bool lower = false;
    *penalty_too_small = false;
    EACH_PHASE(phase) {
        if (retrax_has_inequalities(phase->layout->problem)) {
            bool too_small;
            const double barrier = lowered_barrier(search, phase, penalty_growth, &too_small);
            double *const before = search->at + phase->place + phase->layout->first[RETRAX_ARRAY_BARRIER];
            lower = lower || barrier != *before;
            *before = barrier;
            *penalty_too_small = *penalty_too_small || too_small;
        }
    }
    return lower;
}

bool retrax_update_barrier(retrax_search *search) {
    if (!search->has_inequalities) {
        return false;
    }
    const bool stuck = is_stuck(search);
    bool penalty_too_small;
    const bool lower = lower_barriers(search, &penalty_too_small);
    if (stuck) { /* once more from the guess: multipliers that grew against a bound would hold it there */
        retrax_return_to_guess(search);
        retrax_assess(search, search->at);
        EACH_PHASE(phase) {
            if (retrax_has_inequalities(phase->layout->problem)) {
                enter_elastic_mode(search, phase, search->at + phase->place);
            }
        }
        search->direction.regularisation = 0.0;
    } else if (penalty_too_small) {
        EACH_PHASE(phase) { raise_penalties(phase->layout, search->at + phase->place); }
        if (retrax_is_coupled(search)) {
            multiply(retrax_search_multipliers(search, false), PENALTY_FACTOR,
                     search->coupling.count[RETRAX_COUPLED_MULTIPLIERS]);
        }
    } else {
        if (lower) {
            EACH_PHASE(phase) { retrax_write_right_sides(phase->layout, search->at + phase->place); }
            retrax_measure(search, search->at);
        }
        return lower;
    }
    retrax_assess(search, search->at);
    return true;
}

/* The same for one phase. */
static bool reset_slacks(const retrax_layout *layout, double *trajectory) {
    bool found = false;
    for (retrax_index i = 0; i < layout->count[RETRAX_ARRAY_LIMITS]; i++) {
        const double reset = ARRAY(EXCESSES)[i] - ARRAY(LIMITS)[i], slack = ARRAY(SLACKS)[i];
        if (ARRAY(LIMIT_WEIGHTS)[i] > 0.0 && reset >= LEFT * slack && fabs(reset - slack) > RETRAX_ROOT_EPS * slack) {
            ARRAY(SLACKS)[i] = reset;
            found = true;
        }
    }
    return found;
}

bool retrax_reset_slacks(const retrax_search *search, double *iterate) {
    bool found = false;
    EACH_PHASE(phase) { found = reset_slacks(phase->layout, iterate + phase->place) || found; }
    return found;
}

/* Whether inequalities of a phase contradict each other, or the ends. */
static bool is_infeasible(const retrax_search *search, const retrax_phase *phase) {
    const retrax_layout *const layout = phase->layout;
    if (!retrax_has_inequalities(layout->problem)) {
        return false;
    }
    const double *const trajectory = search->at + phase->place, *const survey = ARRAY(LIMIT_SURVEY);
    const double barrier = *ARRAY(BARRIER), tolerance = search->options.tolerance, left = survey[RETRAX_LIMIT_LEFT];
    const bool small = barrier <= sqrt(tolerance) * phase->limits.rate;
    const bool last = barrier <= 2.0 * RETRAX_LAST_BARRIER * tolerance * phase->limits.rate &&
                      survey[RETRAX_LIMIT_PRODUCT] <= SOLVED * barrier && left > 0.0 &&
                      survey[RETRAX_LIMIT_EXCESS] > tolerance;
    return (small && left > sqrt(tolerance)) || last;
}

bool retrax_is_infeasible(const retrax_search *search) {
    bool found = false;
    EACH_PHASE(phase) { found = found || is_infeasible(search, phase); }
    return found && RESIDUAL(search->at, ERROR_WITHOUT_COMPLEMENTARITY) <= search->options.tolerance;
}
