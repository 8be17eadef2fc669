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
static void find_curved_ways(retrax_search *search, const double *trajectory, retrax_index j, double *ways) {
    const retrax_layout *const layout = search->layout;
    const retrax_problem *const problem = layout->problem;
    const retrax_index c = problem->inequalities, m = problem->control_size, q = retrax_point_unknowns(problem);
    const retrax_index points = problem->steps * problem->points;
    double *const other = search->trial;
    retrax_copy_unknowns(layout, trajectory, other);
    for (retrax_index i = 0; i < points * c; i++) {
        other[layout->first[RETRAX_ARRAY_LIMIT_MULTIPLIERS] + i] = i % c == j ? 1.0 : 0.0;
    }
    retrax_evaluate_trajectory(layout, other);
    if (!retrax_collocates(problem)) { /* the costs of the ends are added to the same Hessians, as in `trajectory` */
        retrax_assemble_system(layout, other, search->workspace, search->set);
    }
    double *const curvatures = search->control_work, *const largest = curvatures + points * m;
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
static void find_straight_ways(const retrax_search *search, const double *trajectory, retrax_index j, double *ways) {
    const retrax_layout *const layout = search->layout;
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
 * there is none, the largest of all steps; and the same in search->room, but infinite where a side is open. */
static void find_room(retrax_search *search, const double *trajectory, double *ways_found) {
    const retrax_problem *const problem = search->layout->problem;
    const retrax_index m = problem->control_size, s = problem->points, points = problem->steps * s;
    double *const ways = search->ways;
    for (retrax_index i = 0; i < 2 * points * m; i++) {
        ways[i] = INFINITY;
    }
    for (retrax_index j = 0; j < problem->inequalities; j++) {
        if (!is_asked(search->layout, trajectory, j)) {
            continue;
        }
        find_straight_ways(search, trajectory, j, ways);
        if (j >= problem->bounds) {
            find_curved_ways(search, trajectory, j, ways);
        }
    }
    for (retrax_index i = 0; i < s * m; i++) {
        ways_found[i] = 0.0;
        search->room[i] = -INFINITY;
        for (retrax_index k = 0; k < problem->steps; k++) {
            const double up = ways[k * s * m + i], down = ways[points * m + k * s * m + i];
            const int closed = (int)isfinite(up) + (int)isfinite(down);
            const double sum = (isfinite(up) ? up : 0.0) + (isfinite(down) ? down : 0.0);
            ways_found[i] = fmax(ways_found[i], sum / (closed > 1 ? 2.0 : 1.0));
            search->room[i] = fmax(search->room[i], (up + down) / 2.0);
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

void retrax_find_scale(retrax_search *search, const double *trajectory, retrax_scale *scale) {
    const retrax_layout *const layout = search->layout;
    const retrax_problem *const problem = layout->problem;
    const retrax_index n = problem->state_size, z = layout->count[RETRAX_ARRAY_PARTS], controls = z - n;
    bool curved = true;
    retrax_measure_motion(layout, trajectory, search->work, search->sizes, search->values);
    for (retrax_index i = 0; i < controls; i++) {
        search->sizes[n + i] = retrax_control_size(layout, trajectory, i);
        search->room[i] = INFINITY;
    }
    if (retrax_is_limited(problem)) {
        double *const ways = search->values + n, largest = 0.0;
        find_room(search, trajectory, ways);
        for (retrax_index i = 0; i < controls; i++) {
            const double way = ways[i] > 0.0 ? ways[i] : 1.0;
            largest = retrax_larger(largest, ARRAY(CURVATURES)[n + i] * way * way);
        }
        for (retrax_index i = 0; i < controls; i++) {
            const double way = ways[i] > 0.0 ? ways[i] : 1.0;
            curved = curved && ARRAY(CURVATURES)[n + i] * way * way > FLAT * largest;
        }
        for (retrax_index i = 0; i < controls && !curved; i++) {
            search->sizes[n + i] = fmax(search->sizes[n + i], ways[i]);
        }
    }
    memcpy(search->values + n, search->sizes + n, sizeof(double) * (size_t)controls);
    const retrax_scale_data data = {search->sizes, search->values, search->room, curved};
    retrax_measure_scale(layout, trajectory, &data, search->workspace, scale);
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

/* Whether no block of the Hessian has a negative eigenvalue beyond rounding: whether that with a little more diagonal
 * has a Cholesky factor. matrix: [z][z] workspace. */
static bool is_convex(const retrax_layout *layout, const double *trajectory, double *matrix) {
    const retrax_index z = layout->count[RETRAX_ARRAY_PARTS];
    for (retrax_index k = 0; k < layout->problem->steps; k++) {
        const double *const hessian = ARRAY(HESSIANS) + k * z * z;
        double norm = 0.0;
        for (retrax_index i = 0; i < z * z; i++) {
            matrix[i] = isfinite(hessian[i]) ? hessian[i] : 0.0;
            norm = sqrt(norm * norm + matrix[i] * matrix[i]);
        }
        for (retrax_index i = 0; i < z && norm > 0.0; i++) {
            const double pivot = matrix[i * z + i] + 2.0 * NEGATIVE * norm;
            if (!(pivot > 0.0)) {
                return false;
            }
            for (retrax_index a = i + 1; a < z; a++) {
                for (retrax_index b = a; b < z; b++) {
                    matrix[a * z + b] -= matrix[i * z + a] * matrix[i * z + b] / pivot;
                }
            }
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

/* Sets the multipliers of the nodes and points to those of a step in which all moves cost about what their sizes make
 * natural; the unknowns stay.
 *
 * Without multipliers the Hessian of the Lagrangian is that of the cost. Where it is flat in a direction that the
 * constraints leave free, as in every problem of least time, how the constraints bend is what bounds a step, and that
 * the multipliers weigh. */
static void find_first_multipliers(retrax_search *search) {
    const retrax_layout *const layout = search->layout;
    retrax_newton_step(search, FIRST_SHIFT);
    if (!search->direction.finite) {
        return;
    }
    double *const at = search->at;
    memset(at + layout->first[RETRAX_ARRAY_STEPS], 0, sizeof(double) * (size_t)layout->count[RETRAX_ARRAY_STEPS]);
    memset(at + layout->first[RETRAX_ARRAY_VELOCITY_STEPS], 0,
           sizeof(double) * (size_t)layout->count[RETRAX_ARRAY_VELOCITY_STEPS]);
    memcpy(at + layout->first[RETRAX_ARRAY_COVECTOR_STEPS], at + layout->first[RETRAX_ARRAY_MULTIPLIER_STEPS],
           sizeof(double) * (size_t)layout->count[RETRAX_ARRAY_MULTIPLIER_STEPS]);
    retrax_copy_unknowns(layout, at, search->trial);
    retrax_move_trajectory(layout, at, 1.0, search->trial);
    retrax_swap(search);
    retrax_assess(search, search->at);
}

/* Whether the guess knows multipliers of inequalities. */
static bool knows_multipliers(const retrax_layout *layout, const double *trajectory) {
    for (retrax_index i = 0; i < layout->count[RETRAX_ARRAY_LIMIT_MULTIPLIERS]; i++) {
        if (ARRAY(LIMIT_MULTIPLIERS)[i] != 0.0) {
            return true;
        }
    }
    return false;
}

/* Evaluates the guess without a pull of inequalities, and finds its natural sizes. */
static void measure_guess(retrax_search *search) {
    retrax_rest_slacks(search->layout, search->at);
    retrax_evaluate(search, search->at);
    retrax_find_scale(search, search->at, &search->judging);
    retrax_copy_scale(search->layout, &search->judging, &search->steps);
    search->first_cost = search->judging.cost;
}

/* Finds the natural sizes of the guess, as where inequalities do not pull yet, and its first slacks. Known multipliers
 * that do not fit tell nothing, nor do the costates that came with them: then the guess has none. */
static void begin(retrax_search *search) {
    const retrax_layout *const layout = search->layout;
    double *const trajectory = search->at;
    const bool known = knows_multipliers(layout, trajectory);
    memcpy(search->spare, trajectory, sizeof(double) * (size_t)layout->numbers); /* all of them have the same data */
    memcpy(search->trial, trajectory, sizeof(double) * (size_t)layout->numbers);
    memcpy(search->first, trajectory, sizeof(double) * (size_t)layout->numbers);
    measure_guess(search);
    if (!retrax_is_limited(layout->problem)) {
        return;
    }
    retrax_find_limits(search, trajectory);
    if (!known) {
        retrax_start_slacks(search, trajectory);
    } else if (!retrax_warm_start(search, search->spare)) {
        memset(ARRAY(COSTATES), 0, sizeof(double) * (size_t)layout->count[RETRAX_ARRAY_COSTATES]);
        memset(ARRAY(POINT_COSTATES), 0, sizeof(double) * (size_t)layout->count[RETRAX_ARRAY_POINT_COSTATES]);
        measure_guess(search);
        retrax_start_slacks(search, trajectory);
    }
    retrax_evaluate(search, trajectory);
}

void retrax_initialise(retrax_search *search) {
    const retrax_layout *const layout = search->layout;
    const bool linear = !retrax_is_limited(layout->problem);
    begin(search);
    retrax_measure(search, search->at);
    /* The first step is Newton's own: where it gains two digits, the problem is nearly linear and has one extremal. */
    retrax_regularised_step(search, 0.0, linear, linear);
    const bool flat = !search->direction.descends || search->direction.shift > 0.0 ||
                      (linear && !search->direction.strict && has_flat_controls(layout, search->at));
    if (flat && is_without_costates(layout, search->at) && is_convex(layout, search->at, search->square)) {
        find_first_multipliers(search);
        retrax_regularised_step(search, 0.0, linear, linear);
    }
    retrax_copy_unknowns(layout, search->at, search->first);
    search->degenerate = search->options.looks && retrax_is_degenerate(search);
}
