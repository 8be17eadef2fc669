/*
 * Algorithm: Newton's method on the conditions of trajectories, made global.
 */
#include "search.h"

#include <float.h>
#include <math.h>
#include <string.h>

/* Share by which the next Newton step has to shrink from one solved iterate to the next: else the linear system is
 * singular. */
#define SHRINKS 0.1
/* Residual that is rounding. */
#define EXACT (64.0 * DBL_EPSILON)
/* Times its scaling factors: a trajectory that has grown so far follows the null vector of a singular system. */
#define GROWN 1e6
/* Times the error: a step that leads to less is a full Newton step. */
#define GAINED 0.1
/* A regularisation has to shorten a step to this share; a step is cut no further than to the other. */
#define SHORTER 0.5
#define SLOW 1e-6
/* Trial points after which the scaling is measured again. */
#define ROUND 40

void retrax_swap(retrax_search *search) {
    double *const before = search->at;
    search->at = search->trial;
    search->trial = before;
}

void retrax_copy_scale(const retrax_layout *layout, const retrax_scale *from, retrax_scale *to) {
    memcpy(to->unknowns, from->unknowns, sizeof(double) * (size_t)layout->count[RETRAX_ARRAY_PARTS]);
    memcpy(to->nodes, from->nodes, sizeof(double) * (size_t)layout->problem->state_size);
    to->cost = from->cost;
}

void retrax_evaluate_functions(const retrax_search *search, double *iterate) {
    EACH_PHASE(phase) { retrax_evaluate_nodes(phase->layout, iterate + phase->place); }
    if (retrax_is_coupled(search)) {
        retrax_evaluate_coupling(search, iterate);
    }
    EACH_PHASE(phase) { retrax_evaluate_points(phase->layout, iterate + phase->place); }
}

void retrax_assemble(const retrax_search *search, double *iterate) {
    EACH_PHASE(phase) {
        double *const trajectory = iterate + phase->place;
        if (retrax_has_inequalities(phase->layout->problem)) {
            retrax_add_inequalities(phase->layout, trajectory);
        }
        retrax_assemble_system(phase->layout, trajectory, search->workspace, search->set);
        retrax_write_right_sides(phase->layout, trajectory);
        retrax_survey_trajectory(phase->layout, trajectory);
    }
}

void retrax_evaluate(const retrax_search *search, double *iterate) {
    retrax_evaluate_functions(search, iterate);
    retrax_assemble(search, iterate);
}

void retrax_measure(retrax_search *search, double *iterate) {
    const bool coupled = retrax_is_coupled(search);
    const double curvature = coupled ? retrax_largest_curvature(search, iterate) : 0.0;
    EACH_PHASE(phase) {
        const bool has_inequalities = retrax_has_inequalities(phase->layout->problem);
        const retrax_residual_scale scale = {phase->judging.nodes, phase->judging.unknowns,
                                             has_inequalities ? phase->judging.cost : curvature, phase->steps.nodes,
                                             phase->steps.cost};
        if (has_inequalities) {
            retrax_survey_inequalities(phase->layout, iterate + phase->place, &phase->limits);
        }
        retrax_measure_residuals(phase->layout, iterate + phase->place, &scale, has_inequalities ? &phase->limits : NULL);
    }
    retrax_measure_by_spans(search, iterate);
    if (coupled) {
        retrax_join_residuals(search, iterate);
    }
}

void retrax_assess(retrax_search *search, double *iterate) {
    retrax_evaluate(search, iterate);
    retrax_measure(search, iterate);
}

void retrax_move_iterate(const retrax_search *search, double alpha, double *iterate) {
    retrax_copy_iterate(search, search->at, iterate);
    EACH_PHASE(phase) { retrax_move_trajectory(phase->layout, search->at + phase->place, alpha, iterate + phase->place); }
    if (retrax_is_coupled(search)) {
        retrax_move_coupling(search, alpha, iterate);
    }
}

void retrax_move_trial(const retrax_search *search) {
    const double alpha = search->backtrack * search->direction.alpha_max;
    retrax_move_iterate(search, alpha, search->trial);
    EACH_PHASE(phase) {
        retrax_move_inequalities(phase->layout, search->at + phase->place, alpha, phase->dual, search->trial + phase->place);
    }
}

/* Restarts the funnel and the best error, as where the barrier has changed. */
static void reset_funnel(retrax_search *search) {
    search->measures = retrax_measures_of(search, search->at);
    search->funnel = fmax(search->measures.infeasibility, search->options.width);
    search->best = RESIDUAL(search->at, BARRIER_ERROR);
    search->backtrack = 1.0;
}

/* Tests convergence where the error of the iterate meets the tolerance, by the next Newton step.
 *
 * Newton steps shrink where the errors vanish, unless the system is singular to rounding. Then the trajectory is
 * one of a family of extremals, or it has grown along the null vector until rounding hides that there is none. */
static void test_convergence(retrax_search *search) {
    double next = 0.0, size = 0.0; /* the largest scaled entries of the next Newton step, and of the spans of the iterate */
    if (!(RESIDUAL(search->at, KKT_ERROR) <= search->options.tolerance)) {
        return;
    }
    EACH_PHASE(phase) {
        for (retrax_index i = 0; i < phase->layout->count[RETRAX_ARRAY_PARTS]; i++) {
            const double unit = phase->judging.unknowns[i];
            const double span = retrax_span_of(phase->layout, search->at + phase->place, i);
            next = retrax_larger(next, phase->largest[i] / fmax(span, RETRAX_SHARE * unit));
            size = retrax_larger(size, span / unit);
        }
    }
    const bool was_isolated = search->isolated, stuck = next > SHRINKS * search->correction;
    search->isolated = next <= sqrt(search->options.tolerance);
    search->converged = search->isolated || (stuck && size <= GROWN);
    search->correction = next;
    const bool exact = was_isolated || RESIDUAL(search->at, BARRIER_ERROR) <= EXACT;
    search->done = (search->isolated && exact) || stuck;
}

/* Whether a regularisation shortens the step, which is `length` long without more of it; where the constraints ask for
 * the step none does. Side effect: where it does not shorten enough by itself, the step becomes that of the least
 * norm. */
static bool regularisation_shortens_step(retrax_search *search, double length) {
    if (!(retrax_step_length(search) > SHORTER * length)) {
        return true;
    }
    retrax_newton_step(search, RETRAX_LEAST_NORM_REGULARISATION);
    return !(retrax_step_length(search) > SHORTER * length);
}

/* Cuts the step before further, which was rejected, where no regularisation shortens it; else the next step has the
 * regularisation that it was computed with, whatever the inertia
 * [test_a_trajectory_that_grows_without_end_is_no_success]. */
static void cut_further(retrax_search *search, const retrax_direction *before, double backtrack, double length) {
    const double regularisation = search->direction.regularisation;
    if (regularisation_shortens_step(search, length)) {
        retrax_regularised_step(search, regularisation, true, false);
    } else {
        retrax_newton_step(search, before->regularisation);
        search->direction.descends = before->descends;
        search->backtrack = backtrack / 2.0;
    }
}

/* Computes the next direction, from the iterate as it is now; error: of the iterate before. */
static void compute_direction(retrax_search *search, double error) {
    const double now = RESIDUAL(search->at, BARRIER_ERROR), tolerance = search->options.tolerance;
    const bool within = RESIDUAL(search->at, KKT_ERROR) <= tolerance;
    const bool accept_any_inertia = within || (search->accepted && now <= sqrt(tolerance));
    const bool curvature_test_only = search->accepted && now <= GAINED * error && !search->has_inequalities;
    retrax_regularised_step(search, within ? 0.0 : search->direction.regularisation, accept_any_inertia,
                            curvature_test_only);
}

/* Evaluates the trial point and judges it, once more with other slacks where it is rejected; an accepted one is the
 * iterate. Returns whether a new step is computed next. */
static bool search_line(retrax_search *search) {
    retrax_move_trial(search);
    retrax_assess(search, search->trial);
    retrax_judgement judgement = retrax_judge_trial(search, search->trials == 1 && !search->has_inequalities);
    if (!judgement.accepted && retrax_reset_slacks(search, search->trial)) {
        retrax_assess(search, search->trial);
        judgement = retrax_judge_trial(search, false);
    }
    search->accepted = judgement.accepted;
    search->direction.regularisation = judgement.regularisation;
    search->backtrack = judgement.backtrack;
    search->funnel = judgement.funnel;
    search->best = judgement.best;
    search->measures = judgement.measures;
    if (search->accepted) {
        retrax_swap(search);
    }
    return judgement.recompute_step;
}

/* Widens the scaling after a rejected trial point where that is too small; before: the direction to it, with its length.
 * Returns whether it does. */
static bool widen_scale(retrax_search *search, const retrax_direction *before, double backtrack, double length) {
    if (!retrax_widen_scale(search, backtrack * before->alpha_max, length)) {
        return false;
    }
    const double next = search->backtrack;
    retrax_measure(search, search->at);
    reset_funnel(search);
    search->backtrack = next;
    search->direction.regularisation = before->regularisation;
    return true;
}

/* One pass of the loop: a trial point of a backtracking line search. At most four halvings follow without a new linear
 * system, then one with a larger regularisation; after an accepted trial point the barrier and the direction are new. */
static void try_step(retrax_search *search) {
    const retrax_direction before = search->direction;
    const double error = RESIDUAL(search->at, BARRIER_ERROR), backtrack = search->backtrack;
    const double length = retrax_step_length(search);
    const bool was_isolated = search->isolated, again = search_line(search);
    const bool rejected = again && !search->accepted && !was_isolated;
    const bool wider = rejected && widen_scale(search, &before, backtrack, length);
    search->trials++;
    const bool changed = retrax_update_barrier(search);
    if (changed) {
        reset_funnel(search);
    }
    search->done = was_isolated && search->accepted && RESIDUAL(search->at, KKT_ERROR) <= search->options.tolerance;
    if (search->done || !(again || changed)) {
        return;
    }
    compute_direction(search, error);
    const bool cut = !search->accepted && !changed && !wider;
    if (cut && before.descends && backtrack > SLOW && backtrack / 2.0 < RETRAX_SHORTEST) {
        cut_further(search, &before, backtrack, length);
    }
    test_convergence(search);
}

/* Whether there is nothing to go on with, and why. */
static retrax_search_status status_of(const retrax_search *search) {
    const retrax_direction *const step = &search->direction;
    if (search->degenerate) {
        return RETRAX_DEGENERATE;
    }
    if (search->done) {
        return search->converged ? RETRAX_CONVERGED : RETRAX_SINGULAR;
    }
    if (isnan(RESIDUAL(search->at, STATIONARITY))) {
        return RETRAX_SINGULAR; /* a derivative is undefined here, and any step from here with it */
    }
    if ((!step->finite || step->regularisation >= RETRAX_LARGEST_REGULARISATION) && !retrax_is_not_yet_elastic(search)) {
        return RETRAX_SINGULAR;
    }
    if (retrax_is_infeasible(search)) {
        return RETRAX_INFEASIBLE;
    }
    return search->trials > search->options.max_iterations ? RETRAX_ITERATION_LIMIT : RETRAX_GOING_ON;
}

/* Restarts the globalisation at the iterate, with a step that is not tried yet. */
static void restart_globalisation(retrax_search *search) {
    search->correction = INFINITY;
    search->isolated = search->converged = search->done = search->accepted = false;
    reset_funnel(search);
    test_convergence(search);
}

/* Continues with the scaling of the iterate where the scaling in use is far larger. */
static void rescale(retrax_search *search) {
    if (retrax_renew_scale(search)) {
        retrax_measure(search, search->at);
        const bool near = RESIDUAL(search->at, BARRIER_ERROR) <= sqrt(search->options.tolerance);
        retrax_regularised_step(search, 0.0, near, near);
        restart_globalisation(search);
    }
}

/* The largest barrier, relative to its unit; 0 without inequalities. */
static double largest_barrier(const retrax_search *search) {
    double found = 0.0;
    EACH_PHASE(phase) {
        const double barrier = search->at[phase->place + phase->layout->first[RETRAX_ARRAY_BARRIER]];
        found = fmax(found, retrax_has_inequalities(phase->layout->problem) ? barrier / phase->limits.rate : 0.0);
    }
    return found;
}

bool retrax_report(const retrax_search *search) {
    const double *const at = search->at;
    const retrax_direction *const step = &search->direction;
    const retrax_iteration iteration = {
        .number = search->trials - 1,
        .cost = at[search->totals],
        .defect = RESIDUAL(at, DEFECT),
        .stationarity = RESIDUAL(at, STATIONARITY),
        .regularisation = step->regularisation,
        .fraction = search->backtrack * step->alpha_max,
        .descends = step->descends,
        .violation = retrax_larger(RESIDUAL(at, VIOLATION), RESIDUAL(at, EXCESS)),
        .barrier = largest_barrier(search),
    };
    return search->options.report != NULL && search->options.report(search->options.context, &iteration);
}

retrax_search_status retrax_search_run(retrax_search *search) {
    retrax_search_status status;
    retrax_initialise(search);
    search->trials = 1;
    restart_globalisation(search);
    for (;;) {
        search->costs[search->trials] = search->at[search->totals];
        status = status_of(search);
        if (status != RETRAX_DEGENERATE && (status != RETRAX_GOING_ON || search->trials % ROUND == 0)) {
            rescale(search);
            status = status_of(search);
        }
        search->stopped = status != RETRAX_DEGENERATE && retrax_report(search);
        if (status != RETRAX_GOING_ON || search->stopped) {
            retrax_conclude(search);
            return status == RETRAX_GOING_ON ? RETRAX_STOPPED : status;
        }
        try_step(search);
    }
}
