/*
 * Funnel: which trials are accepted, and with which regularisation the search goes on.
 *
 * The funnel is a bound on the infeasibility that only narrows [Kiessling, Leyffer, Vanaret, A unified funnel restoration
 * SQP algorithm, 2025]. Where the step promises less cost by more than a share of the squared infeasibility, a trial is
 * accepted if the cost decreases as Armijo asks, but for rounding; else if it comes well into the funnel. The cost is
 * that of the Lagrangian with the multipliers of the trial. Accepted too is what brings the residual below nine tenths of
 * the best so far while nothing alone lacks more than the funnel.
 */
#include "search.h"

#include <float.h>
#include <math.h>

/* Share of the promised decrease of the cost that a trial has to make. */
#define ARMIJO 1e-4
/* Share of the squared infeasibility above which a promise counts. */
#define SWITCH 1e-3
/* Share by which a trial has to come into the funnel, per fraction of the step. */
#define NARROWER 1e-2
/* Shares of the distance to the infeasibility by which the funnel narrows: for less cost, and for less infeasibility. */
#define GENTLY 0.1
#define FIRMLY 0.5
/* Times the best residual so far: of a record, and of a first step that does not descend. */
#define RECORD 0.9
#define FAST 1e-2
/* Decrease of the cost, relative, that is lost in what the cost is a sum of. */
#define ROUNDED (10.0 * DBL_EPSILON)
/* Regularisations: factors up and down, the fraction of a step from which on a smaller one is tried, the first and the
 * smallest. */
#define RAISE 10.0
#define LOWER 4.0
#define FOLLOWED 0.75
#define FIRST_REGULARISATION 1e-4
#define SMALLEST_REGULARISATION 1e-8

/* Less after a whole step, more after one that was cut to a quarter or less, and where none was short enough. */
static double next_regularisation(double regularisation, double made, bool good, bool is_short) {
    if (!good) {
        return is_short ? fmax(RAISE * regularisation, FIRST_REGULARISATION) : regularisation;
    }
    if (made >= FOLLOWED) {
        return regularisation < SMALLEST_REGULARISATION ? 0.0 : regularisation / LOWER;
    }
    return made <= 0.25 ? fmax(regularisation, FIRST_REGULARISATION) * fmin(0.5 / made, RAISE) : regularisation;
}

retrax_measures retrax_measures_of(const retrax_search *search, const double *iterate) {
    return (retrax_measures){RESIDUAL(iterate, INFEASIBILITY), RESIDUAL(iterate, BARRIER_OBJECTIVE), RESIDUAL(iterate, CONSTRAINT_TERM)};
}

/* Whether a trial improves, and the width of the funnel then. */
static bool improves(const retrax_search *search, const retrax_measures *now, double turned, double promised, double part,
                     double *width) {
    const double before = search->measures.infeasibility, cost = search->measures.objective;
    if (promised >= SWITCH * before * before) {
        const double most = cost + turned - ARMIJO * promised + ROUNDED * (fabs(cost) + fabs(turned));
        *width = search->funnel + GENTLY * (now->infeasibility - search->funnel);
        return now->objective + now->constraint_term <= most && now->infeasibility <= search->funnel;
    }
    *width = search->funnel + FIRMLY * (now->infeasibility - search->funnel);
    return now->infeasibility <= (1.0 - NARROWER * part * search->direction.alpha_max) * search->funnel;
}

bool retrax_judge_trial(retrax_search *search, bool first, bool *again) {
    const retrax_direction *const step = &search->direction;
    const double part = search->backtrack, tolerance = search->options.tolerance, residual = RESIDUAL(search->trial, BARRIER_ERROR);
    const double turned = search->measures.constraint_term + part * step->constraint_change;
    const double promised = -part * (step->predicted_change - step->alpha_max * turned);
    const retrax_measures now = retrax_measures_of(search, search->trial);
    double width;
    const bool better = improves(search, &now, turned, promised, part, &width), probe = first && !step->descends;
    const bool inside = RESIDUAL(search->trial, MAX_SCALED_DEFECT) <= fmax(search->funnel, tolerance);
    bool good = better || (inside && residual <= fmax(RECORD * search->best, tolerance));
    if (probe) {
        good = residual <= FAST * search->best;
    }
    good = good && isfinite(residual) && isfinite(search->trial[search->totals]);
    const bool is_short = !good && part / 2.0 < RETRAX_SHORTEST;
    search->direction.regularisation = next_regularisation(step->regularisation, part * step->step_cap, good, is_short);
    if (good) {
        search->funnel = better ? width : fmax(search->funnel, now.infeasibility);
        search->best = fmin(search->best, residual);
        search->measures = now;
    }
    *again = good || is_short || probe;
    search->backtrack = *again ? 1.0 : part / 2.0;
    return good;
}
