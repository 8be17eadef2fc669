/*
 * Control ranges: how far controls can go between their inequalities, which is their scaling factor where the cost is
 * flat.
 */
#include "search.h"

#include <math.h>
#include <string.h>

/* Share of the largest slope, or curvature, of an inequality in a control along the trajectory: where one passes
 * through zero, as those of a cone do, it says nothing of the way. */
#define LEAST 1e-2
/* Curvature of an inequality, relative to the one that it is added to, which is rounding. */
#define SUM_ROUNDING 1e-13

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

/* Writes the second derivatives by the controls of all points of the Lagrangian of the iterate, with multipliers 1 of
 * inequality j and 0 of the others. */
static void find_limit_curvatures(const retrax_search *search, const retrax_phase *phase, retrax_index j, double *to) {
    const retrax_layout *const layout = phase->layout;
    const retrax_problem *const problem = layout->problem;
    const retrax_index c = problem->inequalities, m = problem->control_size, q = retrax_point_unknowns(problem);
    const retrax_index points = problem->steps * problem->points;
    const double *const at = search->at + phase->place;
    double *const trajectory = search->trial + phase->place;
    retrax_copy_unknowns(layout, at, trajectory);
    retrax_rest_slacks(layout, trajectory);
    retrax_copy(ARRAY(START_COST), at + layout->first[RETRAX_ARRAY_START_COST], layout->count[RETRAX_ARRAY_START_COST]);
    retrax_copy(ARRAY(END_COST), at + layout->first[RETRAX_ARRAY_END_COST], layout->count[RETRAX_ARRAY_END_COST]);
    for (retrax_index i = 0; i < points * c; i++) {
        ARRAY(LIMIT_MULTIPLIERS)[i] = i % c == j ? 1.0 : 0.0;
    }
    retrax_evaluate_trajectory(layout, trajectory);
    if (!retrax_collocates(problem)) { /* the costs of the ends are added to the same Hessians, as of the iterate */
        retrax_assemble_system(layout, trajectory, search->workspace, search->set);
    }
    for (retrax_index i = 0; i < points * m; i++) {
        to[i] = curvature_of(layout, trajectory, i / m, q - m + i % m);
    }
}

void retrax_find_limit_curvatures(retrax_search *search) {
    EACH_PHASE(phase) {
        const retrax_problem *const problem = phase->layout->problem;
        const retrax_index count = problem->steps * problem->points * problem->control_size;
        for (retrax_index i = 0; i < retrax_curved_limits(problem); i++) {
            if (is_asked(phase->layout, search->at + phase->place, problem->bounds + i)) {
                find_limit_curvatures(search, phase, problem->bounds + i, phase->limit_curvatures + i * count);
            }
        }
    }
}

/* Lowers the ways of the controls to those inside inequality j, which is curved: for |u|^2 <= r^2 that is |u| + r
 * [test_a_solution_as_guess_is_still_a_strict_minimum]. */
static void find_curved_ways(const retrax_phase *phase, const double *trajectory, retrax_index j, double *ways) {
    const retrax_layout *const layout = phase->layout;
    const retrax_problem *const problem = layout->problem;
    const retrax_index c = problem->inequalities, m = problem->control_size, q = retrax_point_unknowns(problem);
    const retrax_index points = problem->steps * problem->points;
    const double *const raised = phase->limit_curvatures + (j - problem->bounds) * points * m;
    double *const curvatures = phase->control_work, *const largest = curvatures + points * m;
    memset(largest, 0, sizeof(double) * (size_t)m);
    for (retrax_index point = 0; point < points; point++) {
        for (retrax_index b = 0; b < m; b++) {
            const double own = curvature_of(layout, trajectory, point, q - m + b);
            double found = raised[point * m + b] - own;
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

/* Lowers the ways of the controls to either side, to those to inequality j by its slope
 * [test_a_crane_is_judged_by_what_it_costs_in_the_end]. */
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

void retrax_find_control_ranges(retrax_phase *phase, const double *trajectory, double *ways_found) {
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
            find_curved_ways(phase, trajectory, j, ways);
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
