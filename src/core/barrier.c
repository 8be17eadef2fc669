/*
 * Barrier: the natural sizes of the inequalities, their first slacks, and how the barrier falls and penalties grow.
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
/* The first barrier, in natural sizes. */
#define FIRST_BARRIER 0.3
/* Factor by which the cost counts less where penalties are too small. */
#define DEARER 3.0
/* A barrier problem is solved to so many times the barrier; then that falls by a factor, or by a power. */
#define SOLVED 10.0
#define LESS 0.2
#define FASTER 1.5
/* A barrier that exceeds the last one by a smaller share is the last; the last one, times the tolerance. */
#define REACHED (4.0 * DBL_EPSILON)
#define LAST 0.1
/* Above this barrier, relative, excesses are left whatever their penalty. */
#define TELLS 0.1
/* A step of a smaller fraction jams at the inequalities; with a larger shift it is stiff. */
#define JAMMED 1e-3
#define STIFF 1e2
/* A slack that would be less than this share of it stays as its step made it. */
#define LEFT 0.01

static retrax_index limit_of(const retrax_search *search, retrax_index i) {
    return retrax_limit_of(search->layout->problem, i).limit;
}

bool retrax_is_kept(const retrax_search *search, retrax_index i) {
    return search->layout->problem->kept[limit_of(search, i)] != 0.0;
}

/* The natural size of an unknown that an inequality depends on. */
static double size_of_unknown(const retrax_search *search, const retrax_limit *of, retrax_index a) {
    const retrax_problem *const problem = search->layout->problem;
    const retrax_index n = problem->state_size, m = problem->control_size, point = of->block % problem->points;
    if (!retrax_collocates(problem)) {
        return search->steps.unknowns[a];
    }
    if (a >= 3 * n) {
        return search->steps.unknowns[n + point * m + a - 3 * n];
    }
    return a < 2 * n ? search->steps.nodes[a % n] : 0.0; /* no inequality depends on velocities */
}

/* Writes the natural sizes of the inequalities: what a step of natural size changes them by, or their values where that
 * is next to nothing, as that of a ball where its derivative vanishes. */
static void write_limits(retrax_search *search, const double *trajectory) {
    const retrax_layout *const layout = search->layout;
    const retrax_problem *const problem = layout->problem;
    const retrax_index total = problem->inequalities + problem->node_inequalities;
    for (retrax_index j = 0; j < total; j++) {
        double size = 0.0, value = 0.0;
        for (retrax_index i = 0; i < layout->count[RETRAX_ARRAY_LIMITS]; i++) {
            const retrax_limit of = retrax_limit_of(problem, i);
            double change = 0.0;
            for (retrax_index a = 0; a < of.width && of.limit == j; a++) {
                change += fabs(ARRAY(LIMIT_JACOBIANS)[of.first + a]) * size_of_unknown(search, &of, a);
            }
            size = retrax_larger(size, change);
            value = of.limit == j ? retrax_larger(value, fabs(ARRAY(LIMITS)[i])) : value;
        }
        size = size > RETRAX_VALUE_SHARE * value ? size : value;
        search->limit_sizes[j] = size > 0.0 && isfinite(size) ? size : 1.0;
    }
}

double retrax_limit_inside(const retrax_search *search, const double *trajectory, retrax_index i) {
    const retrax_layout *const layout = search->layout;
    const double value = ARRAY(LIMITS)[i], limit = search->limit_sizes[limit_of(search, i)];
    return retrax_is_kept(search, i) ? fmin(value, -DBL_EPSILON * limit) : value;
}

/* Writes the slack, multiplier and excess of an inequality on the central path: g + s = t, nu s = zeta t = mu. */
static void write_central(const retrax_search *search, double *trajectory, retrax_index i, double penalty) {
    const retrax_layout *const layout = search->layout;
    const double mu = *ARRAY(BARRIER), g = retrax_limit_inside(search, trajectory, i);
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
static double first_penalty(const retrax_search *search, retrax_index i) {
    const double unit = search->limits.rate / search->limit_sizes[limit_of(search, i)];
    return retrax_is_kept(search, i) ? INFINITY : RETRAX_FIRST_PENALTY * unit * search->firm;
}

void retrax_rest_slacks(const retrax_layout *layout, double *trajectory) {
    for (retrax_index i = 0; i < layout->count[RETRAX_ARRAY_SLACKS]; i++) {
        ARRAY(SLACKS)[i] = 1.0;
        ARRAY(LIMIT_MULTIPLIERS)[i] = ARRAY(EXCESSES)[i] = 0.0;
        ARRAY(PENALTIES)[i] = INFINITY;
    }
    *ARRAY(BARRIER) = 0.0;
}

void retrax_find_limits(retrax_search *search, const double *trajectory) {
    const retrax_layout *const layout = search->layout;
    double horizon = 0.0;
    for (retrax_index k = 0; k < layout->problem->steps; k++) {
        horizon += ARRAY(STEP_SIZE)[k];
    }
    search->limits.rate = search->steps.cost * (double)layout->problem->steps / horizon;
    write_limits(search, trajectory);
}

void retrax_start_slacks(retrax_search *search, double *trajectory) {
    const retrax_layout *const layout = search->layout;
    retrax_find_limits(search, trajectory);
    *ARRAY(BARRIER) = FIRST_BARRIER * search->limits.rate * sqrt(search->firm);
    for (retrax_index i = 0; i < layout->count[RETRAX_ARRAY_LIMITS]; i++) {
        const double limit = search->limit_sizes[limit_of(search, i)];
        const bool holds = retrax_limit_inside(search, trajectory, i) < -INSIDE * limit;
        write_central(search, trajectory, i, holds ? INFINITY : first_penalty(search, i));
    }
}

bool retrax_is_hard(const retrax_search *search) {
    const retrax_layout *const layout = search->layout;
    const double *const trajectory = search->at;
    for (retrax_index i = 0; i < layout->count[RETRAX_ARRAY_LIMITS]; i++) {
        if (ARRAY(LIMIT_WEIGHTS)[i] > 0.0 && isinf(ARRAY(PENALTIES)[i]) && !retrax_is_kept(search, i)) {
            return true;
        }
    }
    return false;
}

/* Makes all inequalities of a trajectory elastic that can be, on the central path of at least the first barrier. */
static void soften(const retrax_search *search, double *trajectory) {
    const retrax_layout *const layout = search->layout;
    const double first = FIRST_BARRIER * search->limits.rate * sqrt(search->firm);
    *ARRAY(BARRIER) = fmax(*ARRAY(BARRIER), first);
    for (retrax_index i = 0; i < layout->count[RETRAX_ARRAY_LIMITS]; i++) {
        write_central(search, trajectory, i, fmin(ARRAY(PENALTIES)[i], first_penalty(search, i)));
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
        multiply(trajectory + layout->first[scaled[i]], DEARER, layout->count[scaled[i]]);
    }
}

/* The barrier, lower while its problem is solved; cheap: whether penalties are too small to lower it. */
static double lowered(const retrax_search *search, bool *cheap) {
    const retrax_layout *const layout = search->layout;
    const double *const trajectory = search->at, *const survey = ARRAY(LIMIT_SURVEY);
    const double rate = search->limits.rate * fmax(survey[RETRAX_LIMIT_DEAR], 1.0);
    const double last = LAST * search->options.tolerance * search->limits.rate / rate;
    double barrier = *ARRAY(BARRIER);
    *cheap = false;
    for (;;) {
        const double off = retrax_larger(retrax_larger(survey[RETRAX_LIMIT_PRODUCT] - barrier, barrier - survey[RETRAX_LIMIT_LEAST]), 0.0);
        const double own = barrier / rate, enough = fmax(SOLVED * own, search->options.tolerance);
        if (!(ARRAY(RESIDUALS)[RETRAX_STEADY] <= enough && off <= SOLVED * barrier)) {
            return barrier;
        }
        *cheap = survey[RETRAX_LIMIT_CHEAP] > 0.0 && own <= TELLS;
        if (*cheap || !(own > (1.0 + REACHED) * last)) {
            return barrier;
        }
        const double less = fmax(last, fmin(LESS * own, pow(own, FASTER))) * rate;
        if (!(less < barrier)) {
            return barrier; /* rounding of a rate that is next to zero */
        }
        barrier = less;
    }
}

/* Whether steps jam at inequalities that are not elastic. */
static bool is_stuck(const retrax_search *search) {
    const double *const found = search->at + search->layout->first[RETRAX_ARRAY_RESIDUALS];
    const retrax_direction *const step = &search->direction;
    const bool jams = step->shift >= STIFF || search->fraction * step->reach <= JAMMED || !step->finite;
    return jams && found[RETRAX_LARGEST] > sqrt(search->options.tolerance) && retrax_is_hard(search);
}

bool retrax_update_barrier(retrax_search *search) {
    const retrax_layout *const layout = search->layout;
    if (!retrax_is_limited(layout->problem)) {
        return false;
    }
    bool cheap;
    const double barrier = lowered(search, &cheap), before = search->at[layout->first[RETRAX_ARRAY_BARRIER]];
    const bool stuck = is_stuck(search);
    search->at[layout->first[RETRAX_ARRAY_BARRIER]] = barrier;
    if (stuck) { /* once more from the guess: multipliers that grew against a bound would hold it there */
        retrax_copy_unknowns(layout, search->first, search->at);
        retrax_assess(search, search->at);
        soften(search, search->at);
        search->direction.shift = 0.0;
    } else if (cheap) {
        raise_penalties(layout, search->at);
    } else {
        if (barrier != before) {
            retrax_write_right_sides(layout, search->at);
            retrax_measure(search, search->at);
        }
        return barrier != before;
    }
    retrax_assess(search, search->at);
    return true;
}

bool retrax_reset_slacks(const retrax_search *search, double *trajectory) {
    const retrax_layout *const layout = search->layout;
    bool found = false;
    for (retrax_index i = 0; i < layout->count[RETRAX_ARRAY_LIMITS]; i++) {
        const double own = ARRAY(EXCESSES)[i] - ARRAY(LIMITS)[i], made = ARRAY(SLACKS)[i];
        if (ARRAY(LIMIT_WEIGHTS)[i] > 0.0 && own >= LEFT * made && fabs(own - made) > RETRAX_ROOT_EPS * made) {
            ARRAY(SLACKS)[i] = own;
            found = true;
        }
    }
    return found;
}

bool retrax_is_infeasible(const retrax_search *search) {
    const retrax_layout *const layout = search->layout;
    if (!retrax_is_limited(layout->problem)) {
        return false;
    }
    const double *const trajectory = search->at, *const survey = ARRAY(LIMIT_SURVEY), barrier = *ARRAY(BARRIER);
    const double tolerance = search->options.tolerance, left = survey[RETRAX_LIMIT_LEFT];
    const bool small = barrier <= sqrt(tolerance) * search->limits.rate;
    const bool last = barrier <= 2.0 * LAST * tolerance * search->limits.rate &&
                      survey[RETRAX_LIMIT_PRODUCT] <= SOLVED * barrier && left > 0.0 &&
                      survey[RETRAX_LIMIT_EXCESS] > tolerance;
    return ARRAY(RESIDUALS)[RETRAX_STEADY] <= tolerance && ((small && left > sqrt(tolerance)) || last);
}
