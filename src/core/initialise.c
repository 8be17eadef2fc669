/*
 * Initialise: natural sizes, first slacks and first multipliers of a guess.
 */
#include "search.h"

#include <math.h>
#include <string.h>

/* Share of the largest curvature in the controls, by their ways to the bounds, of which less is rounding. */
#define FLAT 1e-8
/* Share of the largest slope, or curvature, of an inequality in a control along the trajectory: where one passes
 * through zero, as those of a cone do, it says nothing of the way. */
#define LEAST 1e-2
/* Curvature of an inequality, relative to the one that it is added to, which is rounding. */
#define SUM_ROUNDING 1e-13
/* Shift of the first multipliers: a move by the size of a coordinate costs as much as the size of the cost. */
#define FIRST_SHIFT 1.0
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

/* ------------------------------------------------------------------------------------------- room of the controls */

/* The second derivative by a control of a point in the Hessian of the Lagrangian. */
static double curvature_of(const retrax_layout *layout, const double *trajectory, retrax_index point, retrax_index a) {
    const retrax_index q = retrax_point_unknowns(layout->problem);
    const double *const hessians = retrax_collocates(layout->problem) ? ARRAY(POINT_HESSIANS) : ARRAY(HESSIANS);
    return hessians[(point * q + a) * q + a];
}

/* Whether an inequality is asked for at some point. */
static bool is_asked(const retrax_layout *layout, const double *trajectory, retrax_index j) {
    const retrax_problem *const problem = layout->problem;
    for (retrax_index i = j; i < problem->steps * problem->points * problem->inequalities; i += problem->inequalities) {
        if (ARRAY(LIMIT_WEIGHTS)[i] > 0.0) {
            return true;
        }
    }
    return false;
}

/* Lowers the ways of the controls to those inside inequality j, which is curved: for |u|^2 <= r^2 that is |u| + r. */
static void find_curved_ways(const retrax_search *search, const retrax_phase *phase, const double *trajectory,
                             retrax_index j, double *ways) {
    const retrax_layout *const layout = phase->layout;
    const retrax_problem *const problem = layout->problem;
    const retrax_index c = problem->inequalities, m = problem->control_size, q = retrax_point_unknowns(problem);
    const retrax_index points = problem->steps * problem->points;
    double *const other = search->trial + phase->place;
    retrax_copy_unknowns(layout, trajectory, other);
    retrax_copy(other + layout->first[RETRAX_ARRAY_START_COST], ARRAY(START_COST), layout->count[RETRAX_ARRAY_START_COST]);
    retrax_copy(other + layout->first[RETRAX_ARRAY_END_COST], ARRAY(END_COST), layout->count[RETRAX_ARRAY_END_COST]);
    for (retrax_index i = 0; i < points * c; i++) {
        other[layout->first[RETRAX_ARRAY_LIMIT_MULTIPLIERS] + i] = i % c == j ? 1.0 : 0.0;
    }
    retrax_evaluate_trajectory(layout, other);
    if (!retrax_collocates(problem)) { /* the costs of the ends are added to the same Hessians, as in `trajectory` */
        retrax_assemble_system(layout, other, search->workspace, search->set);
    }
    double *const curvatures = phase->control_work, *const largest = curvatures + points * m;
    memset(largest, 0, sizeof(double) * (size_t)m);
    for (retrax_index point = 0; point < points; point++) {
        for (retrax_index b = 0; b < m; b++) {
            const double own = curvature_of(layout, trajectory, point, q - m + b);
            double found = curvature_of(layout, other, point, q - m + b) - own;
            found = fabs(found) > SUM_ROUNDING * fabs(own) ? found / ARRAY(LIMIT_WEIGHTS)[point * c + j] : 0.0;
            curvatures[point * m + b] = found;
            largest[b] = retrax_larger(largest[b], isfinite(found) ? found : 0.0);
        }
    }
    for (retrax_index point = 0; point < points; point++) {
        const double *const slope = ARRAY(LIMIT_JACOBIANS) + (point * c + j) * q + q - m;
        const double value = fabs(ARRAY(LIMITS)[point * c + j]);
        double *const curvature = curvatures + point * m, sum = 0.0;
        for (retrax_index b = 0; b < m; b++) {
            curvature[b] = curvature[b] > 0.0 ? fmax(curvature[b], LEAST * largest[b]) : curvature[b];
            sum += curvature[b] > 0.0 ? slope[b] * slope[b] / curvature[b] : 0.0;
        }
        for (retrax_index b = 0; b < m; b++) {
            const double way = (sqrt(sum) + sqrt(sum + 2.0 * value)) / sqrt(curvature[b]);
            for (int side = 0; side < 2 && curvature[b] > 0.0 && isfinite(way); side++) {
                double *const to = ways + (side * points + point) * m + b;
                *to = fmin(*to, way);
            }
        }
    }
}

/* Lowers the ways of the controls to either side, to those to inequality j by its slope. */
static void find_straight_ways(const retrax_layout *layout, const double *trajectory, retrax_index j, double *ways) {
    const retrax_problem *const problem = layout->problem;
    const retrax_index c = problem->inequalities, m = problem->control_size, q = retrax_point_unknowns(problem);
    const retrax_index points = problem->steps * problem->points;
    for (retrax_index b = 0; b < m; b++) {
        double largest = 0.0;
        for (retrax_index i = j; i < points * c; i += c) {
            const double slope = fabs(ARRAY(LIMIT_JACOBIANS)[i * q + q - m + b]);
            largest = ARRAY(LIMIT_WEIGHTS)[i] > 0.0 && isfinite(slope) ? retrax_larger(largest, slope) : largest;
        }
        for (retrax_index i = j; i < points * c; i += c) {
            const double slope = ARRAY(LIMIT_JACOBIANS)[i * q + q - m + b];
            if (slope != 0.0 && ARRAY(LIMIT_WEIGHTS)[i] > 0.0) {
                double *const to = ways + ((slope > 0.0 ? 0 : points) + i / c) * m + b;
                *to = fmin(*to, fabs(ARRAY(LIMITS)[i]) / fmax(fabs(slope), LEAST * largest));
            }
        }
    }
}

/* Writes half of the way of each control of a step from one inequality to the other, or that to the only one, 0 where
 * there is none, the largest of all steps; and the same in phase->room, but infinite where a side is open. */
static void find_room(const retrax_search *search, retrax_phase *phase, const double *trajectory, double *ways_found) {
    const retrax_problem *const problem = phase->layout->problem;
    const retrax_index m = problem->control_size, s = problem->points, points = problem->steps * s;
    double *const ways = phase->ways;
    for (retrax_index i = 0; i < 2 * points * m; i++) {
        ways[i] = INFINITY;
    }
    for (retrax_index j = 0; j < problem->inequalities; j++) {
        if (!is_asked(phase->layout, trajectory, j)) {
            continue;
        }
        find_straight_ways(phase->layout, trajectory, j, ways);
        if (j >= problem->bounds) {
            find_curved_ways(search, phase, trajectory, j, ways);
        }
    }
    for (retrax_index i = 0; i < s * m; i++) {
        ways_found[i] = 0.0;
        phase->room[i] = -INFINITY;
        for (retrax_index k = 0; k < problem->steps; k++) {
            const double up = ways[k * s * m + i], down = ways[points * m + k * s * m + i];
            const int closed = (int)isfinite(up) + (int)isfinite(down);
            const double sum = (isfinite(up) ? up : 0.0) + (isfinite(down) ? down : 0.0);
            ways_found[i] = fmax(ways_found[i], sum / (closed > 1 ? 2.0 : 1.0));
            phase->room[i] = fmax(phase->room[i], (up + down) / 2.0);
        }
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
    if (retrax_is_limited(problem)) {
        double *const ways = phase->values + n, largest = 0.0;
        find_room(search, phase, trajectory, ways);
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
    retrax_measure_scale(layout, trajectory, &data, search->workspace, &phase->fresh);
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
static bool is_convex(const retrax_layout *layout, const double *trajectory, double *matrix) {
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
    EACH_PHASE(phase) { found = found && is_convex(phase->layout, search->at + phase->place, phase->square); }
    return found;
}

/* Sets the multipliers of the nodes and points to those of a step in which all moves cost about what their sizes make
 * natural; the unknowns stay.
 *
 * Without multipliers the Hessian of the Lagrangian is that of the cost. Where it is flat in a direction that the
 * constraints leave free, as in every problem of least time, how the constraints bend is what bounds a step, and that
 * the multipliers weigh. */
static void find_first_multipliers(retrax_search *search) {
    retrax_newton_step(search, FIRST_SHIFT);
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

/* Evaluates the guess as where inequalities do not pull yet, and finds its natural sizes. */
static void measure_guess(retrax_search *search) {
    EACH_PHASE(phase) { retrax_rest_slacks(phase->layout, search->at + phase->place); }
    retrax_evaluate(search, search->at);
    retrax_find_scales(search, search->at);
    EACH_PHASE(phase) {
        retrax_copy_scale(phase->layout, &phase->fresh, &phase->judging);
        retrax_copy_scale(phase->layout, &phase->fresh, &phase->steps);
        if (retrax_is_limited(phase->layout->problem)) {
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
        if (retrax_is_limited(phase->layout->problem) && !phase->knows) {
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
    retrax_copy(search->spare, search->at, search->numbers); /* all of them have the same data */
    retrax_copy(search->trial, search->at, search->numbers);
    retrax_copy(search->first, search->at, search->numbers);
    measure_guess(search);
    if (!search->limited) {
        return;
    }
    start_slacks(search);
    if (known && !retrax_warm_start(search, search->spare)) {
        retrax_forget_multipliers(search, search->at);
        EACH_PHASE(phase) { phase->knows = false; }
        measure_guess(search);
        start_slacks(search);
    }
    retrax_evaluate(search, search->at);
}

void retrax_initialise(retrax_search *search) {
    const bool linear = !search->limited;
    bool flat_controls = false;
    retrax_begin(search);
    retrax_measure(search, search->at);
    EACH_PHASE(phase) { flat_controls = flat_controls || has_flat_controls(phase->layout, search->at + phase->place); }
    /* The first step is Newton's own: where it gains two digits, the problem is nearly linear and has one extremal. */
    retrax_regularised_step(search, 0.0, linear, linear);
    const bool flat = !search->direction.descends || search->direction.shift > 0.0 ||
                      (linear && !search->direction.strict && flat_controls);
    if (flat && is_without_way(search)) {
        find_first_multipliers(search);
        retrax_regularised_step(search, 0.0, linear, linear);
    }
    retrax_copy_iterate(search, search->at, search->first);
    search->degenerate = search->options.looks && retrax_is_degenerate(search);
}
