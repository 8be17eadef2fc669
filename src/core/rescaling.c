/*
 * Rescaling: scaling factors that a search has come to, in the place of those of its guess.
 */
#include "search.h"

#include <math.h>

/* Times its scaling factor: a size that the second-order change of a step exceeds by less is not mistaken. */
#define WIDER 10.0
/* Share of a scaling factor: where the sizes of the iterate are less, they take its place. */
#define LESS 0.1
/* Times the size of the cost, the least fall of the cost, and the fewest trials, that tell that it has no lower bound. */
#define FALLEN 1e2
#define FEWEST 20

/* What nodes and points lack in coordinate a, summed over the trajectory. */
static double summed_defect(const retrax_layout *layout, const double *trajectory, retrax_index a) {
    return ARRAY(SUMMED_DEFECTS)[a] + ARRAY(POINT_SURVEY)[RETRAX_POINTS_TOTAL * layout->problem->state_size + a];
}

/* [test_a_rate_that_only_products_change_is_no_obstacle] */
bool retrax_widen_scale(retrax_search *search, double part, double length) {
    retrax_phase *const phase = search->phases;
    const double moved = part * length;
    bool wider = false;
    for (retrax_index a = 0; a < phase->layout->problem->state_size && !retrax_is_coupled(search); a++) {
        const double before = summed_defect(phase->layout, search->at, a);
        const double left = summed_defect(phase->layout, search->trial, a) - (1.0 - part) * before;
        const double second = left / (moved * moved);
        if (isfinite(second) && second > WIDER * phase->steps.nodes[a]) {
            phase->steps.nodes[a] = phase->steps.unknowns[a] = second;
            wider = true;
        }
    }
    return wider;
}

bool retrax_cost_diverges(const retrax_search *search) {
    const double *const costs = search->costs;
    const retrax_index last = search->trials, middle = last / 2 > 1 ? last / 2 : 1;
    const double early = costs[1] - costs[middle], late = costs[middle] - costs[last];
    return early + late > FALLEN * search->first_cost && last >= FEWEST && late >= early;
}

/* Whether the trajectory moves by more than rounding of a prescribed end. */
static bool moves(const retrax_layout *layout, const double *trajectory) {
    for (retrax_index e = 0; e < layout->problem->state_numbers; e++) {
        const double high = ARRAY(HIGHEST)[e], low = ARRAY(LOWEST)[e];
        const double given = fmax(fabs(ARRAY(START)[e]) * ARRAY(START_ENTRIES)[e],
                                  fabs(ARRAY(END)[e]) * ARRAY(END_ENTRIES)[e]);
        if (high + low > RETRAX_STILL * fmax(high, low) && given > 0.0) {
            return true;
        }
    }
    return false;
}

/* Whether its controls move it by more than rounding of its states: else no success is what it seems
 * [test_a_wild_guess_does_not_set_the_measure_of_success]. A trajectory without controls moves by itself, but of several
 * phases one may rest, and then has no size
 * [test_an_arc_that_rests_between_two_that_do_not]. */
static bool acts(const retrax_search *search, const retrax_phase *phase, const double *trajectory) {
    const retrax_layout *const layout = phase->layout;
    const retrax_index n = layout->problem->state_size, z = layout->count[RETRAX_ARRAY_PARTS];
    retrax_measure_motion(layout, trajectory, phase->work, phase->sizes, phase->values);
    for (retrax_index a = 0; a < n; a++) {
        double pushed = 0.0;
        for (retrax_index i = n; i < z; i++) {
            double sum = 0.0;
            for (retrax_index k = 0; k < layout->problem->steps; k++) {
                sum += fabs(ARRAY(RIGHT)[(k * n + a) * z + i]);
            }
            pushed += sum * retrax_control_size(layout, trajectory, i - n);
        }
        if (pushed > RETRAX_ROOT_EPS * phase->values[a]) {
            return true;
        }
    }
    return z == n && !retrax_is_coupled(search);
}

/* Whether the sizes in use are far larger than those of the iterate, phase->fresh. */
static bool are_outgrown(const retrax_search *search) {
    bool less = false, more = false, goes = false, pushes = false;
    EACH_PHASE(phase) {
        const retrax_index z = phase->layout->count[RETRAX_ARRAY_PARTS];
        for (retrax_index i = 0; i <= z; i++) {
            const double own = i < z ? phase->fresh.unknowns[i] : phase->fresh.cost;
            const double used = i < z ? phase->judging.unknowns[i] : phase->judging.cost;
            const double share = fmin(own, used) / used;
            less = less || share < LESS;
            more = more || share > RETRAX_ROOT_EPS;
        }
    }
    EACH_PHASE(phase) {
        pushes = pushes || (less && acts(search, phase, search->at + phase->place));
        goes = goes || moves(phase->layout, search->at + phase->place);
    }
    return less && pushes && (more || goes);
}

/* Takes the sizes of the iterate, the lesser ones to judge by; coupled trajectories have one measure for both, but for
 * the cost, which multipliers make larger than it is. */
static void take_fresh(const retrax_search *search, retrax_phase *phase) {
    const retrax_index n = phase->layout->problem->state_size, z = phase->layout->count[RETRAX_ARRAY_PARTS];
    const bool coupled = retrax_is_coupled(search);
    retrax_copy_scale(phase->layout, &phase->fresh, &phase->steps);
    for (retrax_index i = 0; i < z; i++) {
        const double own = phase->fresh.unknowns[i];
        phase->judging.unknowns[i] = coupled ? own : fmin(phase->judging.unknowns[i], own);
    }
    for (retrax_index a = 0; a < n; a++) {
        const double own = phase->fresh.nodes[a];
        phase->judging.nodes[a] = coupled ? own : fmin(phase->judging.nodes[a], own);
    }
    phase->judging.cost = fmin(phase->judging.cost, phase->fresh.cost);
    phase->steps.cost = phase->judging.cost;
}

/* [test_members_of_a_batch_have_units_of_their_own] */
bool retrax_renew_scale(retrax_search *search) {
    if (!search->converged && retrax_cost_diverges(search)) { /* a cost that falls without end has no size */
        return false;
    }
    double *at = search->at;
    if (search->has_inequalities) { /* as where inequalities do not pull */
        retrax_find_limit_curvatures(search);
        at = search->trial;
        retrax_copy_iterate(search, search->at, at);
        EACH_PHASE(phase) { retrax_rest_slacks(phase->layout, at + phase->place); }
        retrax_evaluate(search, at);
    }
    retrax_find_scales(search, at);
    if (!are_outgrown(search)) {
        return false;
    }
    EACH_PHASE(phase) {
        take_fresh(search, phase);
        if (retrax_has_inequalities(phase->layout->problem)) {
            retrax_find_limits(phase, at + phase->place);
        }
    }
    if (retrax_is_coupled(search)) {
        retrax_copy(search->coupling.sizes, search->coupling.fresh, search->coupling.count[RETRAX_COUPLED_VALUES]);
    }
    return true;
}
