/*
 * Funnel: which trials are accepted, and with which regularisation the search goes on.
 *
 * The funnel is a bound on the infeasibility that only narrows [Kiessling, Leyffer, Vanaret, A unified funnel restoration
 * SQP algorithm, 2025]. Where the step predicts less cost by more than a share of the squared infeasibility, a trial is
 * accepted if the cost decreases as Armijo asks, but for rounding; else if it comes well into the funnel. The cost is
 * that of the Lagrangian with the multipliers of the trial. A trial point is also accepted if its error is below nine
 * tenths of the best one so far while no single scaled defect exceeds the funnel width.
 */
#include "search.h"

#include <float.h>
#include <math.h>

/* Share of the predicted reduction that a trial has to make. */
#define ARMIJO 1e-4
/* Share of the squared infeasibility above which a predicted reduction counts. */
#define SWITCH 1e-3
/* Share by which a trial has to come into the funnel, per fraction of the step. */
#define NARROWER 1e-2
/* Shares of the distance to the infeasibility by which the funnel narrows: for less cost, and for less infeasibility. */
#define GENTLY 0.1
#define FIRMLY 0.5
/* Times the best error so far: of a record, and of a first step that does not descend. */
#define RECORD 0.9
#define FAST 1e-2
/* Decrease of the cost, relative, that is lost in what the cost is a sum of. */
#define ROUNDED (10.0 * DBL_EPSILON)
/* Regularisations: the factor down, the fraction of a step from which on a smaller one is tried, and the smallest. */
#define LOWER 4.0
#define WHOLE 0.75
#define SMALLEST_REGULARISATION 1e-8

/* Less after a whole step, more after one that was cut to a quarter or less, and where none was short enough. */
static double next_regularisation(double regularisation, double made, bool good, bool is_short) {
    if (!good) {
        return is_short ? fmax(RETRAX_REGULARISATION_FACTOR * regularisation, RETRAX_FIRST_REGULARISATION) : regularisation;
    }
    if (made >= WHOLE) {
        return regularisation < SMALLEST_REGULARISATION ? 0.0 : regularisation / LOWER;
    }
    const double larger = fmax(regularisation, RETRAX_FIRST_REGULARISATION);
    return made <= 0.25 ? larger * fmin(0.5 / made, RETRAX_REGULARISATION_FACTOR) : regularisation;
}

retrax_measures retrax_measures_of(const retrax_search *search, const double *iterate) {
    return (retrax_measures){RESIDUAL(iterate, INFEASIBILITY), RESIDUAL(iterate, BARRIER_OBJECTIVE),
                             RESIDUAL(iterate, CONSTRAINT_TERM)};
}

/* Whether a trial point improves, and the width of the funnel then. term: the constraint term with the multipliers of the
 * trial point to first order; reduction: the predicted one of the objective. */
static bool improves(const retrax_search *search, const retrax_measures *now, double term, double reduction,
                     double *width) {
    const double before = search->measures.infeasibility, objective = search->measures.objective;
    if (reduction >= SWITCH * before * before) {
        const double most = objective + term - ARMIJO * reduction + ROUNDED * (fabs(objective) + fabs(term));
        *width = search->funnel + GENTLY * (now->infeasibility - search->funnel);
        return now->objective + now->constraint_term <= most && now->infeasibility <= search->funnel;
    }
    *width = search->funnel + FIRMLY * (now->infeasibility - search->funnel);
    return now->infeasibility <= (1.0 - NARROWER * search->backtrack * search->direction.alpha_max) * search->funnel;
}

retrax_judgement retrax_judge_trial(const retrax_search *search, bool first) {
    const retrax_direction *const step = &search->direction;
    const double backtrack = search->backtrack, tolerance = search->options.tolerance;
    const double error = RESIDUAL(search->trial, BARRIER_ERROR);
    const double term = search->measures.constraint_term + backtrack * step->constraint_change;
    const double reduction = -backtrack * (step->predicted_change - step->alpha_max * term);
    const retrax_measures now = retrax_measures_of(search, search->trial);
    double width;
    const bool better = improves(search, &now, term, reduction, &width), probe = first && !step->descends;
    const bool inside = RESIDUAL(search->trial, MAX_SCALED_DEFECT) <= fmax(search->funnel, tolerance);
    bool good = better || (inside && error <= fmax(RECORD * search->best, tolerance));
    if (probe) {
        good = error <= FAST * search->best;
    }
    good = good && isfinite(error) && isfinite(search->trial[search->totals]);
    const bool is_short = !good && backtrack / 2.0 < RETRAX_SHORTEST, again = good || is_short || probe;
    return (retrax_judgement){
        .accepted = good,
        .recompute_step = again,
        .regularisation = next_regularisation(step->regularisation, backtrack * step->step_cap, good, is_short),
        .backtrack = again ? 1.0 : backtrack / 2.0,
        .funnel = !good ? search->funnel : (better ? width : fmax(search->funnel, now.infeasibility)),
        .best = good ? fmin(search->best, error) : search->best,
        .measures = good ? now : search->measures,
    };
}
