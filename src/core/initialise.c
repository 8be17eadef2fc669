/*
 * Initialise: scaling factors, first slacks and first multipliers of a guess.
 */
#include "search.h"

#include <math.h>
#include <string.h>

/* Share of the largest curvature in the controls, by their ways to the bounds, of which less is rounding. */
#define FLAT 1e-8
/* Regularisation of the first multipliers: a move by the size of a coordinate costs as much as the size of the cost. */
#define GUESS_REGULARISATION 1.0
/* Share of the size of a block below which a negative eigenvalue of it is rounding. */
#define NEGATIVE 1e-9

void retrax_copy_unknowns(const retrax_layout *layout, const double *from, double *to) {
    static const retrax_array copied[] = {
        RETRAX_ARRAY_CENTRES,  RETRAX_ARRAY_VELOCITIES,        RETRAX_ARRAY_CONTROLS, RETRAX_ARRAY_POINT_COSTATES,
        RETRAX_ARRAY_COSTATES, RETRAX_ARRAY_SLACKS,            RETRAX_ARRAY_LIMIT_MULTIPLIERS,
        RETRAX_ARRAY_EXCESSES, RETRAX_ARRAY_PENALTIES,         RETRAX_ARRAY_BARRIER};
    for (size_t i = 0; i < sizeof(copied) / sizeof(copied[0]); i++) {
        memcpy(to + layout->first[copied[i]], from + layout->first[copied[i]],
               sizeof(double) * (size_t)layout->count[copied[i]]);
    }
}

void retrax_copy_iterate(const retrax_search *search, const double *from, double *to) {
    EACH_PHASE(phase) { retrax_copy_unknowns(phase->layout, from + phase->place, to + phase->place); }
    if (retrax_is_coupled(search)) {
        const retrax_index first = search->coupling.first[RETRAX_COUPLED_MULTIPLIERS];
        retrax_copy(to + first, from + first, search->coupling.count[RETRAX_COUPLED_MULTIPLIERS]);
    }
}

void retrax_keep_guess(retrax_search *search) {
    EACH_PHASE(phase) {
        const retrax_index known = phase->layout->first[RETRAX_ARRAY_POINT_CENTRES];
        retrax_copy(search->first + phase->guess_place, search->at + phase->place, known);
    }
    if (retrax_is_coupled(search)) {
        const retrax_index count = search->coupling.count[RETRAX_COUPLED_MULTIPLIERS];
        retrax_copy(search->first + search->guess_multipliers, retrax_search_multipliers(search, false), count);
    }
}

void retrax_return_to_guess(retrax_search *search) {
    EACH_PHASE(phase) {
        const retrax_index known = phase->layout->first[RETRAX_ARRAY_POINT_CENTRES];
        retrax_copy(search->at + phase->place, search->first + phase->guess_place, known);
    }
    if (retrax_is_coupled(search)) {
        const retrax_index count = search->coupling.count[RETRAX_COUPLED_MULTIPLIERS];
        retrax_copy(retrax_search_multipliers(search, false), search->first + search->guess_multipliers, count);
    }
}

/* ---------------------------------------------------------------------------------------------------------- scale */

/* The largest size along the trajectory of a number that stands at a place of each step. */
static double largest_of(const retrax_layout *layout, const double *numbers, retrax_index stride, retrax_index place) {
    double size = 0.0;
    for (retrax_index k = 0; k < layout->problem->steps; k++) {
        size = retrax_larger(size, fabs(numbers[k * stride + place]));
    }
    return size;
}

double retrax_control_size(const retrax_layout *layout, const double *trajectory, retrax_index i) {
    const retrax_problem *const problem = layout->problem;
    const retrax_index s = problem->points, m = problem->control_size, U = problem->control_numbers;
    const retrax_index point = i / m;
    if (!problem->curved_controls) { /* as many numbers as coordinates */
        return largest_of(layout, ARRAY(CONTROLS), s * m, i);
    }
    double size = 0.0;
    for (retrax_index e = 0; e < U; e++) {
        const double direction = largest_of(layout, ARRAY(CONTROL_FRAMES), s * m * U, i * U + e);
        size = retrax_larger(size, direction * largest_of(layout, ARRAY(CONTROLS), s * U, point * U + e));
    }
    return size;
}

void retrax_find_scale(retrax_search *search, retrax_phase *phase, const double *trajectory, const double *least) {
    const retrax_layout *const layout = phase->layout;
    const retrax_problem *const problem = layout->problem;
    const retrax_index n = problem->state_size, z = layout->count[RETRAX_ARRAY_PARTS], controls = z - n;
    bool curved = true;
    retrax_measure_motion(layout, trajectory, phase->work, phase->sizes, phase->values);
    for (retrax_index a = 0; a < n && least != NULL; a++) {
        phase->sizes[a] = fmax(phase->sizes[a], least[a]);
    }
    for (retrax_index i = 0; i < controls; i++) {
        phase->sizes[n + i] = retrax_control_size(layout, trajectory, i);
        phase->room[i] = INFINITY;
    }
    if (retrax_has_inequalities(problem)) {
        double *const ways = phase->values + n, largest = 0.0;
        retrax_find_control_ranges(phase, trajectory, ways);
        for (retrax_index i = 0; i < controls; i++) {
            const double way = retrax_or_one(ways[i]);
            largest = retrax_larger(largest, ARRAY(CURVATURES)[n + i] * way * way);
        }
        for (retrax_index i = 0; i < controls; i++) {
            const double way = retrax_or_one(ways[i]);
            curved = curved && ARRAY(CURVATURES)[n + i] * way * way > FLAT * largest;
        }
        for (retrax_index i = 0; i < controls && !curved; i++) {
            phase->sizes[n + i] = fmax(phase->sizes[n + i], ways[i]);
        }
    }
    memcpy(phase->values + n, phase->sizes + n, sizeof(double) * (size_t)controls);
    const retrax_scale_data data = {phase->sizes, phase->values, phase->room, curved};
    retrax_measure_scale(layout, trajectory, &data, search->workspace, search->set, &phase->fresh);
}

void retrax_find_scales(retrax_search *search, double *iterate) {
    if (retrax_is_coupled(search)) {
        retrax_find_coupled_scales(search, iterate);
    } else {
        retrax_find_scale(search, search->phases, iterate, NULL);
    }
}

/* ------------------------------------------------------------------------------------------------ first multipliers */

/* Whether all costates are zero. */
static bool is_without_costates(const retrax_layout *layout, const double *trajectory) {
    for (retrax_index i = 0; i < layout->count[RETRAX_ARRAY_COSTATES]; i++) {
        if (ARRAY(COSTATES)[i] != 0.0) {
            return false;
        }
    }
    return true;
}

/* Whether no block of the Hessian has a negative eigenvalue beyond rounding; matrix: [z][z] workspace. */
static bool are_blocks_positive(const retrax_layout *layout, const double *trajectory, double *matrix) {
    const retrax_index z = layout->count[RETRAX_ARRAY_PARTS];
    for (retrax_index k = 0; k < layout->problem->steps; k++) {
        const double *const hessian = ARRAY(HESSIANS) + k * z * z;
        double norm = 0.0;
        for (retrax_index i = 0; i < z * z; i++) {
            norm = sqrt(norm * norm + hessian[i] * hessian[i]);
        }
        if (norm > 0.0 && !retrax_is_positive_definite(hessian, z, z, 2.0 * NEGATIVE * norm, matrix)) {
            return false;
        }
    }
    return true;
}

/* Whether the Hessian has no curvature at all in a control. Where it has some and the system is singular all the same,
 * constraints depend on each other. */
static bool has_flat_controls(const retrax_layout *layout, const double *trajectory) {
    for (retrax_index i = layout->problem->state_size; i < layout->count[RETRAX_ARRAY_PARTS]; i++) {
        if (ARRAY(CURVATURES)[i] == 0.0) {
            return true;
        }
    }
    return false;
}

/* Whether the cost alone does not say which way to go: no trajectory has costates, and no Hessian is curved downward. */
static bool is_without_way(const retrax_search *search) {
    bool found = true;
    EACH_PHASE(phase) { found = found && is_without_costates(phase->layout, search->at + phase->place); }
    EACH_PHASE(phase) { found = found && are_blocks_positive(phase->layout, search->at + phase->place, phase->square); }
    return found;
}

/* Sets the multipliers of the nodes and points to those of a step in which all moves cost about what their sizes make
 * natural; the unknowns stay.
 *
 * Without multipliers the Hessian of the Lagrangian is that of the cost. Where it is flat in a direction that the
 * constraints leave free, as in every problem of least time, how the constraints bend is what bounds a step, and that
 * the multipliers weigh [test_least_time_with_a_heading_needs_no_bounds_of_the_horizon]. */
static void find_first_multipliers(retrax_search *search) {
    retrax_newton_step(search, GUESS_REGULARISATION);
    if (!search->direction.finite) {
        return;
    }
    EACH_PHASE(phase) {
        const retrax_layout *const layout = phase->layout;
        double *const trajectory = search->at + phase->place;
        memset(ARRAY(STEPS), 0, sizeof(double) * (size_t)layout->count[RETRAX_ARRAY_STEPS]);
        memset(ARRAY(VELOCITY_STEPS), 0, sizeof(double) * (size_t)layout->count[RETRAX_ARRAY_VELOCITY_STEPS]);
        retrax_copy(ARRAY(COVECTOR_STEPS), ARRAY(MULTIPLIER_STEPS), layout->count[RETRAX_ARRAY_MULTIPLIER_STEPS]);
    }
    retrax_move_iterate(search, 1.0, search->trial);
    retrax_swap(search);
    retrax_assess(search, search->at);
}

/* Whether the guess of a trajectory knows multipliers of inequalities. */
static bool knows_multipliers(const retrax_layout *layout, const double *trajectory) {
    for (retrax_index i = 0; i < layout->count[RETRAX_ARRAY_LIMIT_MULTIPLIERS]; i++) {
        if (ARRAY(LIMIT_MULTIPLIERS)[i] != 0.0) {
            return true;
        }
    }
    return false;
}

/* Evaluates the guess as where inequalities do not pull yet, and finds its scaling factors. */
static void measure_guess(retrax_search *search) {
    EACH_PHASE(phase) { retrax_rest_slacks(phase->layout, search->at + phase->place); }
    retrax_evaluate(search, search->at);
    retrax_find_limit_curvatures(search);
    retrax_find_scales(search, search->at);
    EACH_PHASE(phase) {
        retrax_copy_scale(phase->layout, &phase->fresh, &phase->judging);
        retrax_copy_scale(phase->layout, &phase->fresh, &phase->steps);
        if (retrax_has_inequalities(phase->layout->problem)) {
            retrax_find_limits(phase, search->at + phase->place);
        }
    }
    if (retrax_is_coupled(search)) {
        retrax_copy(search->coupling.sizes, search->coupling.fresh, search->coupling.count[RETRAX_COUPLED_VALUES]);
    }
    search->first_cost = search->phases->judging.cost;
}

void retrax_forget_multipliers(const retrax_search *search, double *iterate) {
    EACH_PHASE(phase) {
        const retrax_layout *const layout = phase->layout;
        double *const trajectory = iterate + phase->place;
        memset(ARRAY(COSTATES), 0, sizeof(double) * (size_t)layout->count[RETRAX_ARRAY_COSTATES]);
        memset(ARRAY(POINT_COSTATES), 0, sizeof(double) * (size_t)layout->count[RETRAX_ARRAY_POINT_COSTATES]);
    }
    if (retrax_is_coupled(search)) {
        memset(iterate + search->coupling.first[RETRAX_COUPLED_MULTIPLIERS], 0,
               sizeof(double) * (size_t)search->coupling.count[RETRAX_COUPLED_MULTIPLIERS]);
    }
}

/* Sets first slacks of the phases that know none. */
static void start_slacks(retrax_search *search) {
    EACH_PHASE(phase) {
        if (retrax_has_inequalities(phase->layout->problem) && !phase->knows) {
            retrax_start_slacks(search, phase, search->at + phase->place);
        }
    }
}

/* Known multipliers that do not fit tell nothing, nor do the costates that came with them: then the guess has none. */
void retrax_begin(retrax_search *search) {
    bool known = false;
    EACH_PHASE(phase) {
        phase->knows = knows_multipliers(phase->layout, search->at + phase->place);
        known = known || phase->knows;
    }
    retrax_keep_guess(search);
    retrax_swap(search);
    retrax_return_to_guess(search); /* both have the same data */
    retrax_swap(search);
    measure_guess(search);
    if (!search->has_inequalities) {
        return;
    }
    start_slacks(search);
    if (known && !retrax_warm_start(search)) {
        retrax_forget_multipliers(search, search->at);
        EACH_PHASE(phase) { phase->knows = false; }
        measure_guess(search);
        start_slacks(search);
    }
    retrax_evaluate(search, search->at);
}

void retrax_initialise(retrax_search *search) {
    const bool linear = !search->has_inequalities;
    bool flat_controls = false;
    retrax_begin(search);
    retrax_measure(search, search->at);
    EACH_PHASE(phase) { flat_controls = flat_controls || has_flat_controls(phase->layout, search->at + phase->place); }
    /* The first step is Newton's own: where it gains two digits, the problem is nearly linear and has one extremal. */
    retrax_regularised_step(search, 0.0, linear, linear);
    const bool flat = !search->direction.descends || search->direction.regularisation > 0.0 ||
                      (linear && !search->direction.strict && flat_controls);
    if (flat && is_without_way(search)) {
        find_first_multipliers(search);
        retrax_regularised_step(search, 0.0, linear, linear);
    }
    retrax_keep_guess(search);
    search->degenerate = search->options.detect_degenerate && retrax_is_degenerate(search);
}
