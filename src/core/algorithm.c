/*
 * Algorithm: Newton's method on the conditions of trajectories, made global.
 */
#include "search.h"

#include <float.h>
#include <math.h>
#include <string.h>

/* Share by which a wanted step has to shrink from one solved iterate to the next: else the linear system is singular. */
#define SHRINKS 0.1
/* Residual that is rounding. */
#define EXACT (64.0 * DBL_EPSILON)
/* Times its scaling factors: a trajectory that has grown so far follows the null vector of a singular system. */
#define GROWN 1e6
/* Times the residual: a step that leads to less is Newton's own. */
#define GAINED 0.1
/* A regularisation has to shorten a step to this share; a step is cut no further than to the other. */
#define SHORTER 0.5
#define SLOW 1e-6
/* Trials after which scaling factors are measured again. */
#define ROUND 40

void retrax_swap(retrax_search *search) {
    double *const before = search->at;
    search->at = search->trial;
    search->trial = before;
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
        if (has_inequalities) {
            retrax_survey_inequalities(phase->layout, iterate + phase->place, &phase->limits);
        }
        retrax_measure_residuals(phase->layout, iterate + phase->place, &phase->scale,
                                 has_inequalities ? phase->scale.cost : curvature, has_inequalities ? &phase->limits : NULL);
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

void retrax_move_iterate(const retrax_search *search, double part, double *iterate) {
    retrax_copy_iterate(search, search->at, iterate);
    EACH_PHASE(phase) { retrax_move_trajectory(phase->layout, search->at + phase->place, part, iterate + phase->place); }
    if (retrax_is_coupled(search)) {
        retrax_move_coupling(search, part, iterate);
    }
}

void retrax_move_trial(const retrax_search *search) {
    const double part = search->backtrack * search->direction.alpha_max;
    retrax_move_iterate(search, part, search->trial);
    EACH_PHASE(phase) {
        retrax_move_inequalities(phase->layout, search->at + phase->place, part, phase->dual, search->trial + phase->place);
    }
}

/* Begins anew with the funnel and the best residual, as where the barrier has changed. */
static void reset_funnel(retrax_search *search) {
    search->measures = retrax_measures_of(search, search->at);
    search->funnel = fmax(search->measures.infeasibility, search->options.width);
    search->best = RESIDUAL(search->at, BARRIER_ERROR);
    search->backtrack = 1.0;
}

/* Decides what the iterate is where its residuals meet the tolerance, by the step that is still wanted there.
 *
 * Newton's steps shrink where the residuals vanish, unless the system is singular to rounding. Then the trajectory is
 * one of a family of extremals, or it has grown along the null vector until rounding hides that there is none. */
static void settle(retrax_search *search) {
    double wanted = 0.0, grown = 0.0;
    if (!(RESIDUAL(search->at, KKT_ERROR) <= search->options.tolerance)) {
        return;
    }
    EACH_PHASE(phase) {
        for (retrax_index i = 0; i < phase->layout->count[RETRAX_ARRAY_PARTS]; i++) {
            const double unit = phase->scale.unknowns[i], span = retrax_span_of(phase->layout, search->at + phase->place, i);
            wanted = retrax_larger(wanted, phase->largest[i] / fmax(span, RETRAX_SHARE * unit));
            grown = retrax_larger(grown, span / unit);
        }
    }
    const bool was_isolated = search->isolated, stuck = wanted > SHRINKS * search->correction;
    search->isolated = wanted <= sqrt(search->options.tolerance);
    search->claimed = search->isolated || (stuck && grown <= GROWN);
    search->correction = wanted;
    const bool exact = was_isolated || RESIDUAL(search->at, BARRIER_ERROR) <= EXACT;
    search->done = (search->isolated && exact) || stuck;
}

/* Whether no regularisation shortens the step, as where the constraints ask for it. */
static bool is_vain(retrax_search *search, double length) {
    if (!(retrax_step_length(search) > SHORTER * length)) {
        return false;
    }
    retrax_newton_step(search, RETRAX_LEAST_NORM_REGULARISATION);
    return retrax_step_length(search) > SHORTER * length;
}

/* Cuts the step before further, which was refused, where no regularisation shortens it; else the next step has the
 * regularisation that it was computed with, whatever the inertia
 * [test_a_trajectory_that_grows_without_end_is_no_success]. */
static void cut_further(retrax_search *search, const retrax_direction *before, double fraction, double length) {
    const double regularisation = search->direction.regularisation;
    if (is_vain(search, length)) {
        retrax_newton_step(search, before->regularisation);
        search->direction.descends = before->descends;
        search->backtrack = fraction / 2.0;
    } else {
        retrax_regularised_step(search, regularisation, true, false);
    }
}

/* Computes the next step, from the iterate as it is now; residual: of the iterate before. */
static void next_step(retrax_search *search, double residual) {
    const double now = RESIDUAL(search->at, BARRIER_ERROR), tolerance = search->options.tolerance;
    const bool arrived = RESIDUAL(search->at, KKT_ERROR) <= tolerance;
    const bool keep = arrived || (search->accepted && now <= sqrt(tolerance));
    const bool gains = search->accepted && now <= GAINED * residual && !search->has_inequalities;
    retrax_regularised_step(search, arrived ? 0.0 : search->direction.regularisation, keep, gains);
}

/* One iteration: try the step, judge the trial, update the barrier, compute the next step. */
static void iterate(retrax_search *search) {
    const retrax_direction before = search->direction;
    const double residual = RESIDUAL(search->at, BARRIER_ERROR), fraction = search->backtrack;
    const double length = retrax_step_length(search);
    const bool was_isolated = search->isolated;
    bool again;
    retrax_move_trial(search);
    retrax_assess(search, search->trial);
    search->accepted = retrax_judge_trial(search, search->trials == 1 && !search->has_inequalities, &again);
    if (search->accepted) {
        retrax_swap(search);
    }
    const bool refused = again && !search->accepted && !was_isolated;
    const bool wider = refused && retrax_widen_scale(search, fraction * before.alpha_max, length);
    if (wider) {
        const double tried = search->backtrack;
        retrax_measure(search, search->at);
        reset_funnel(search);
        search->backtrack = tried;
        search->direction.regularisation = before.regularisation;
    }
    search->trials++;
    const bool changed = retrax_update_barrier(search);
    if (changed) {
        reset_funnel(search);
    }
    search->done = was_isolated && search->accepted && RESIDUAL(search->at, KKT_ERROR) <= search->options.tolerance;
    if (search->done || !(again || changed)) {
        return;
    }
    next_step(search, residual);
    const bool cut = !search->accepted && !changed && !wider;
    if (cut && before.descends && fraction > SLOW && fraction / 2.0 < RETRAX_SHORTEST) {
        cut_further(search, &before, fraction, length);
    }
    settle(search);
}

/* Whether there is nothing to go on with, and why. */
static retrax_search_status status_of(const retrax_search *search) {
    const retrax_direction *const step = &search->direction;
    if (search->degenerate) {
        return RETRAX_DEGENERATE;
    }
    if (search->done) {
        return search->claimed ? RETRAX_CONVERGED : RETRAX_SINGULAR;
    }
    if ((!step->finite || step->regularisation >= RETRAX_LARGEST_REGULARISATION) && !retrax_is_hard(search)) {
        return RETRAX_SINGULAR;
    }
    if (retrax_is_infeasible(search)) {
        return RETRAX_INFEASIBLE;
    }
    return search->trials > search->options.max_iterations ? RETRAX_ITERATION_LIMIT : RETRAX_GOING_ON;
}

/* Stands at the iterate with a step that is not tried yet. */
static void stand(retrax_search *search) {
    search->correction = INFINITY;
    search->isolated = search->claimed = search->done = search->accepted = false;
    reset_funnel(search);
    settle(search);
}

/* Goes on in the scaling factors of the iterate where those in use are far larger. */
static void renew(retrax_search *search) {
    if (retrax_renew_scale(search)) {
        retrax_measure(search, search->at);
        const bool near = RESIDUAL(search->at, BARRIER_ERROR) <= sqrt(search->options.tolerance);
        retrax_regularised_step(search, 0.0, near, near);
        stand(search);
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
    stand(search);
    for (;;) {
        search->costs[search->trials] = search->at[search->totals];
        status = status_of(search);
        if (status != RETRAX_DEGENERATE && (status != RETRAX_GOING_ON || search->trials % ROUND == 0)) {
            renew(search);
            status = status_of(search);
        }
        search->stopped = status != RETRAX_DEGENERATE && retrax_report(search);
        if (status != RETRAX_GOING_ON || search->stopped) {
            retrax_conclude(search);
            return status == RETRAX_GOING_ON ? RETRAX_STOPPED : status;
        }
        iterate(search);
    }
}
