/*
 * Restoration: the feasibility phase, from a guess to a trajectory near to it on which the equations hold, whatever it
 * costs.
 *
 * Gauss-Newton steps, each the least that meets the linearised equations, shortened until the infeasibility decreases.
 * Multipliers are zero throughout: those of a poor guess bend the Lagrangian far more than the cost does. Inequalities
 * stay inside by their barrier; those that the guess violates are elastic [Nocedal, Wright, Numerical Optimization, 2006,
 * 10.3; Waechter, Biegler, On the implementation of an interior-point filter line-search algorithm, Math. Program. 106,
 * 2006, 3.3].
 */
#include "search.h"

#include <math.h>

/* Decrease of the infeasibility, times the fraction of a step that is made: less is no progress. */
#define DECREASE 1e-2
/* The shortest fraction of a step. */
#define SHORTEST 1e-3
/* Factors of the fraction of a step, after a refused one and after an accepted one. */
#define CUT 0.25
#define LONGER 4.0
/* Share of the infeasibility: near to feasible a step that leaves more is held by rounding or by an inequality. */
#define RESTORED 0.1

/* Takes the guess without multipliers, and finds its scaling factors and first slacks. */
static void begin(retrax_search *search) {
    retrax_forget_multipliers(search, search->at);
    EACH_PHASE(phase) { retrax_rest_slacks(phase->layout, search->at + phase->place); }
    retrax_begin(search);
    retrax_measure(search, search->at);
    search->backtrack = 1.0;
    search->trials = 1;
    search->stopped = false;
}

/* Tries the step; whether the trial is accepted. It meets the inequalities that hold by slacks of its own. */
static bool try_step(retrax_search *search) {
    const double share = 1.0 - DECREASE * search->backtrack * search->direction.alpha_max;
    retrax_move_trial(search);
    retrax_forget_multipliers(search, search->trial);
    retrax_evaluate(search, search->trial);
    if (retrax_reset_slacks(search, search->trial)) {
        retrax_evaluate(search, search->trial);
    }
    retrax_measure(search, search->trial);
    return RESIDUAL(search->trial, INFEASIBILITY) <= share * RESIDUAL(search->at, INFEASIBILITY);
}

retrax_feasibility retrax_search_restore(retrax_search *search, retrax_index max_trials) {
    const double tolerance = search->options.tolerance;
    bool near, crawls = false, moved = true;
    begin(search);
    for (;;) {
        const double before = RESIDUAL(search->at, INFEASIBILITY);
        near = before <= sqrt(tolerance);
        if ((near && (crawls || before <= tolerance)) || !(search->backtrack >= SHORTEST) || search->stopped ||
            search->trials > max_trials) {
            break;
        }
        if (moved) {
            retrax_newton_step(search, RETRAX_LEAST_NORM_REGULARISATION);
        }
        moved = try_step(search);
        crawls = !moved || RESIDUAL(search->trial, INFEASIBILITY) > RESTORED * before;
        if (moved) {
            retrax_swap(search);
        }
        search->trials++;
        search->direction.descends = moved;
        search->stopped = retrax_report(search);
        search->backtrack = moved ? fmin(LONGER * search->backtrack, 1.0) : CUT * search->backtrack;
    }
    const double violation = retrax_larger(RESIDUAL(search->at, INFEASIBILITY), RESIDUAL(search->at, EXCESS));
    EACH_PHASE(phase) { retrax_rest_slacks(phase->layout, search->at + phase->place); }
    return (retrax_feasibility){search->trials - 1, near, violation <= tolerance, search->stopped};
}
