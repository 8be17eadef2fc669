/*
 * Rescaling: natural sizes that a search has come to, in the place of those of its guess.
 */
#include "search.h"

#include <math.h>

/* Times its natural size: a size that the second-order change of a step exceeds by less is not mistaken. */
#define WIDER 10.0
/* Share of a natural size: where the sizes of the iterate are less, they take its place. */
#define LESS 0.1
/* Times the size of the cost, the least fall of the cost, and the fewest trials, that tell that it has no lower bound. */
#define FALLEN 1e2
#define FEWEST 20

/* What nodes and points lack in coordinate a, summed over the trajectory. */
static double lacking(const retrax_layout *layout, const double *trajectory, retrax_index a) {
    return ARRAY(MISSING)[a] + ARRAY(POINT_SURVEY)[RETRAX_POINTS_TOTAL * layout->problem->state_size + a];
}

bool retrax_widen_scale(retrax_search *search, double part, double length) {
    const retrax_layout *const layout = search->layout;
    const double moved = part * length;
    bool wider = false;
    for (retrax_index a = 0; a < layout->problem->state_size; a++) {
        const double left = lacking(layout, search->trial, a) - (1.0 - part) * lacking(layout, search->at, a);
        const double second = left / (moved * moved);
        if (isfinite(second) && second > WIDER * search->steps.nodes[a]) {
            search->steps.nodes[a] = search->steps.unknowns[a] = second;
            wider = true;
        }
    }
    return wider;
}

bool retrax_cost_falls(const retrax_search *search) {
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

/* Whether its controls move it by more than rounding of its states. */
static bool acts(retrax_search *search) {
    const retrax_layout *const layout = search->layout;
    const double *const trajectory = search->at;
    const retrax_index n = layout->problem->state_size, z = layout->count[RETRAX_ARRAY_PARTS];
    retrax_measure_motion(layout, trajectory, search->work, search->sizes, search->values);
    for (retrax_index a = 0; a < n; a++) {
        double pushed = 0.0;
        for (retrax_index i = n; i < z; i++) {
            double sum = 0.0;
            for (retrax_index k = 0; k < layout->problem->steps; k++) {
                sum += fabs(ARRAY(RIGHT)[(k * n + a) * z + i]);
            }
            pushed += sum * retrax_control_size(layout, trajectory, i - n);
        }
        if (pushed > RETRAX_ROOT_EPS * search->values[a]) {
            return true;
        }
    }
    return false;
}

/* Whether the sizes in use are far larger than those of the iterate, search->fresh. */
static bool are_outgrown(retrax_search *search) {
    const retrax_index z = search->layout->count[RETRAX_ARRAY_PARTS];
    bool less = false, more = false;
    for (retrax_index i = 0; i <= z; i++) {
        const double own = i < z ? search->fresh.unknowns[i] : search->fresh.cost;
        const double used = i < z ? search->judging.unknowns[i] : search->judging.cost;
        const double share = fmin(own, used) / used;
        less = less || share < LESS;
        more = more || share > RETRAX_ROOT_EPS;
    }
    return less && acts(search) && (more || moves(search->layout, search->at));
}

bool retrax_renew_scale(retrax_search *search) {
    const retrax_layout *const layout = search->layout;
    const retrax_index n = layout->problem->state_size, z = layout->count[RETRAX_ARRAY_PARTS];
    const bool limited = retrax_is_limited(layout->problem);
    if (!search->claimed && retrax_cost_falls(search)) { /* a cost that falls without end has no size */
        return false;
    }
    const double *at = search->at;
    if (limited) { /* as where inequalities do not pull */
        retrax_copy_unknowns(layout, search->at, search->spare);
        retrax_rest_slacks(layout, search->spare);
        retrax_evaluate(search, search->spare);
        at = search->spare;
    }
    retrax_find_scale(search, at, &search->fresh);
    if (!are_outgrown(search)) {
        return false;
    }
    retrax_copy_scale(layout, &search->fresh, &search->steps);
    for (retrax_index i = 0; i < z; i++) {
        search->judging.unknowns[i] = fmin(search->judging.unknowns[i], search->fresh.unknowns[i]);
    }
    for (retrax_index a = 0; a < n; a++) {
        search->judging.nodes[a] = fmin(search->judging.nodes[a], search->fresh.nodes[a]);
    }
    search->judging.cost = fmin(search->judging.cost, search->fresh.cost);
    search->steps.cost = search->judging.cost;
    if (limited) {
        retrax_find_limits(search, at);
    }
    return true;
}
