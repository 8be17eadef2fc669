/*
 * Conclusion: whether what a search has found is an extremal, and whether the conditions of second order hold there.
 *
 * Where an inequality is active its stiffness D grows without bound as the barrier vanishes: H + w J' D J then has a
 * curvature beside it that is small relative to its entries, and lost in their rounding. Newton's steps bear that, the
 * inertia does not. With e = w dnu as unknowns the system
 *
 *     [H  J'        ]
 *     [J  -1 / (w D)]
 *
 * has no large entries, and the inertia of the other one with one negative eigenvalue more for each inequality. So an
 * inequality counts by its stiffness: as a constraint where it is active, not at all elsewhere.
 */
#include "search.h"

#include <math.h>
#include <string.h>

/* Share of the largest entry of the states: ends that are no farther apart meet. */
#define MET 1e-6
/* Share of the largest entry of an array: ends that are farther apart do not meet. */
#define APART 1e-3
/* In units of the cost and of the inequality: the largest stiffness that is not rounding, and one over the least. */
#define STIFFEST 1e6
#define IDLE 1e6

/* Whether ends of steps are not as far apart as the arrays of the states are large, whatever gaps are measured by.
 *
 * Where natural sizes have lost their meaning, as where controls reach next to nothing or next to everything, a gap in
 * these sizes says nothing. */
static bool do_ends_meet(const retrax_search *search) {
    const retrax_layout *const layout = search->phases->layout;
    const double *const trajectory = search->at;
    const retrax_index E = layout->problem->state_numbers, *const arrays = layout->problem->arrays;
    const double share = fmax(APART, 10.0 * search->options.tolerance);
    double size = 0.0;
    for (retrax_index e = 0; e < E; e++) {
        size = retrax_larger(size, retrax_larger(ARRAY(HIGHEST)[e], ARRAY(LOWEST)[e]));
    }
    for (retrax_index e = 0; e < E; e++) {
        double apart = 0.0, own = 0.0;
        for (retrax_index f = 0; f < E; f++) {
            if (arrays[f] == arrays[e]) {
                apart = retrax_larger(apart, ARRAY(DISTANCE)[f]);
                own = retrax_larger(own, retrax_larger(ARRAY(HIGHEST)[f], ARRAY(LOWEST)[f]));
            }
        }
        if (apart > MET * size && apart > share * own) {
            return false;
        }
    }
    return true;
}

bool retrax_is_extremal(const retrax_search *search) {
    const bool claimed = search->claimed && RESIDUAL(search->at, FINAL) <= search->options.tolerance;
    return claimed && (retrax_is_coupled(search) || do_ends_meet(search));
}

/* Whether the Hessians by the controls of all points are positive definite, with the share of the inequalities. */
static bool is_convex(const retrax_phase *phase, const double *trajectory) {
    const retrax_layout *const layout = phase->layout;
    const retrax_problem *const problem = layout->problem;
    const double *const hessians = retrax_collocates(problem) ? ARRAY(POINT_HESSIANS) : ARRAY(HESSIANS);
    const retrax_index m = problem->control_size, q = retrax_point_unknowns(problem);
    for (retrax_index point = 0; point < problem->steps * problem->points; point++) {
        if (!retrax_is_positive_definite(hessians + (point * q + q - m) * q + q - m, m, q, 0.0, phase->square)) {
            return false;
        }
    }
    return true;
}

/* Writes the derivatives of an inequality of step k by the unknowns of the step. */
static void write_row(const retrax_layout *layout, const double *trajectory, retrax_index k, retrax_index i, double *row) {
    const retrax_problem *const problem = layout->problem;
    const retrax_limit of = retrax_limit_of(problem, i);
    const retrax_index s = problem->points, n = problem->state_size, m = problem->control_size, z = n + s * m;
    const double *const own = ARRAY(LIMIT_JACOBIANS) + of.first, h = ARRAY(STEP_SIZE)[k];
    if (!retrax_collocates(problem)) {
        retrax_copy(row, own, z);
        return;
    }
    const retrax_index point = of.at_ends ? 0 : of.block - k * s;
    memset(row, 0, sizeof(double) * (size_t)z);
    retrax_copy(row, own, n);
    if (!of.at_ends) {
        retrax_copy(row + n + point * m, own + 3 * n, m);
    }
    for (retrax_index j = 0; j < s; j++) {
        const double share = h * (of.at_ends ? problem->weights[j] : problem->matrix[point * s + j]);
        for (retrax_index a = 0; a < n; a++) {
            const double slope = share * own[n + a] + (!of.at_ends && j == point ? own[2 * n + a] : 0.0);
            const double *const map = ARRAY(VELOCITY_MAPS) + ((k * s + j) * n + a) * (z + 1);
            for (retrax_index b = 0; b < z && slope != 0.0; b++) {
                row[b] += slope * map[b];
            }
        }
    }
}

/* The place of inequality r of step k among all of the trajectory. */
static retrax_index limit_place(const retrax_problem *problem, retrax_index k, retrax_index r) {
    const retrax_index own = problem->points * problem->inequalities, d = problem->node_inequalities;
    return r < own ? k * own + r : problem->steps * own + k * d + r - own;
}

/* Writes natural sizes of the unknowns of the augmented system, and 1 / (w D); infinite where nothing is asked for.
 *
 * softly: no inequality is stiffer than STIFFEST, and one that is next to not stiff is not at all. What is positive
 * definite with less stiffness is so with more, and two inequalities that hold almost the same, as at points beside
 * the one that a trajectory touches, leave no small pivots. */
static void write_sizes(const retrax_phase *phase, const double *trajectory, const retrax_scale *units, bool softly) {
    const retrax_layout *const layout = phase->layout;
    const retrax_problem *const problem = layout->problem;
    const retrax_augmented *const own = &phase->augmented;
    const retrax_index z = layout->count[RETRAX_ARRAY_PARTS], limits = own->size - z;
    retrax_copy(own->sizes, units->unknowns, z);
    memset(own->sizes + z, 0, sizeof(double) * (size_t)limits);
    for (retrax_index i = 0; i < problem->steps * limits; i++) {
        double reach = 0.0;
        const retrax_index place = limit_place(problem, i / limits, i % limits);
        own->gives[i] = 1.0 / (ARRAY(LIMIT_WEIGHTS)[place] * retrax_stiffness(layout, trajectory, place));
        for (retrax_index b = 0; b < z; b++) {
            reach += fabs(own->rows[i * z + b]) * units->unknowns[b];
        }
        if (isfinite(own->gives[i])) {
            own->sizes[z + i % limits] = retrax_larger(own->sizes[z + i % limits], reach);
        }
    }
    for (retrax_index r = 0; r < limits; r++) {
        const double reach = own->sizes[z + r], size = reach > 0.0 ? units->cost / reach : units->cost;
        const double unit = units->cost / (size * size);
        own->sizes[z + r] = size;
        for (retrax_index k = 0; k < problem->steps && softly; k++) {
            double *const give = own->gives + k * limits + r;
            *give = *give < IDLE * unit ? fmax(*give, unit / STIFFEST) : INFINITY;
        }
    }
}

/* Writes the blocks of the augmented system. */
static void write_blocks(const retrax_phase *phase, const double *trajectory, double cost) {
    const retrax_layout *const layout = phase->layout;
    const retrax_augmented *const own = &phase->augmented;
    const retrax_index n = layout->problem->state_size, z = layout->count[RETRAX_ARRAY_PARTS], y = own->size, limits = y - z;
    for (retrax_index k = 0; k < layout->problem->steps; k++) {
        double *const hessian = own->hessian + k * y * y;
        memset(hessian, 0, sizeof(double) * (size_t)(y * y));
        for (retrax_index i = 0; i < z; i++) {
            retrax_copy(hessian + i * y, ARRAY(HESSIANS) + (k * z + i) * z, z);
        }
        for (retrax_index r = 0; r < limits; r++) {
            const double give = own->gives[k * limits + r], size = own->sizes[z + r];
            hessian[(z + r) * y + z + r] = -(isfinite(give) ? give : cost / (size * size));
            for (retrax_index b = 0; b < z && isfinite(give); b++) {
                hessian[(z + r) * y + b] = hessian[b * y + z + r] = own->rows[(k * limits + r) * z + b];
            }
        }
        for (retrax_index a = k * n; a < (k + 1) * n; a++) {
            memset(own->left + a * y, 0, sizeof(double) * (size_t)y);
            memset(own->right + a * y, 0, sizeof(double) * (size_t)y);
            retrax_copy(own->left + a * y, ARRAY(LEFT) + a * z, z);
            retrax_copy(own->right + a * y, ARRAY(RIGHT) + a * z, z);
        }
    }
}

/* The augmented system of a phase; trajectory: without the share of the inequalities in its Hessians. */
static retrax_block_system augmented_system(const retrax_phase *phase, const double *trajectory, bool softly) {
    const retrax_layout *const layout = phase->layout;
    const retrax_scale *const units = softly ? &phase->judging : &phase->steps;
    const retrax_augmented *const own = &phase->augmented;
    const retrax_index N = layout->problem->steps, n = layout->problem->state_size;
    write_sizes(phase, trajectory, units, softly);
    write_blocks(phase, trajectory, units->cost);
    memset(own->zeros, 0, sizeof(double) * (size_t)((N + 1) * (own->size + n)));
    return (retrax_block_system){
        .stages = N,
        .node_size = n,
        .stage_size = own->size,
        .columns = 1,
        .hessian = own->hessian,
        .left = own->left,
        .right = own->right,
        .slope = own->zeros,
        .defect = own->zeros,
        .fixed_start = ARRAY(FIXED),
        .fixed_end = ARRAY(FIXED) + N * n,
        .stage_scale = own->sizes,
        .node_scale = units->nodes,
        .cost_scale = units->cost,
        .regularisation = 0.0,
        .regularised = own->zeros,
    };
}

/* Adds the inertia of a phase, without the eigenvalues of its inequalities. */
static void add_phase(const retrax_search *search, retrax_phase *phase, bool softly, retrax_inertia *inertia) {
    const retrax_augmented *const own = &phase->augmented;
    const retrax_layout *const layout = phase->layout;
    const bool limited = retrax_is_limited(layout->problem);
    const retrax_block_system system = limited ? augmented_system(phase, search->trial + phase->place, softly)
                                               : retrax_newton_system(search, phase, 0.0);
    unsigned char finite;
    retrax_block_solution solution = {
        .step = own->step, .multipliers = own->multipliers, .finite = &finite, .largest_step = own->largest};
    if (retrax_is_coupled(search)) {
        double *const hessians = search->at + phase->place + layout->first[RETRAX_ARRAY_HESSIANS];
        solution.inertia = retrax_respond(search, phase, system, limited ? own->hessian : hessians);
    } else {
        retrax_block_eliminate(&system, &solution, search->workspace, search->set);
    }
    solution.inertia.negative -= layout->problem->steps * (own->size - layout->count[RETRAX_ARRAY_PARTS]);
    retrax_add_inertia(inertia, solution.inertia);
}

/* Whether the inertia of all phases with their coupling is that of a minimum; clear: beyond rounding. */
static bool is_right(retrax_search *search, bool softly, bool *clear) {
    retrax_inertia found = {0, INFINITY};
    retrax_index equations = 0;
    EACH_PHASE(phase) {
        add_phase(search, phase, softly, &found);
        equations += phase->layout->count[RETRAX_ARRAY_DEFECTS];
    }
    const retrax_index more = retrax_is_coupled(search) ? retrax_add_border(search, &found) : 0;
    *clear = retrax_is_clear(found.smallest, equations);
    return found.negative == equations + more;
}

/* Whether the Hessian of the Lagrangian is positive definite on the null space of the constraints, beyond rounding,
 * where there are inequalities. */
static bool is_strict(retrax_search *search) {
    bool clear;
    retrax_copy_iterate(search, search->at, search->trial);
    retrax_evaluate_functions(search, search->trial);
    EACH_PHASE(phase) { /* without the share of the inequalities in the Hessians */
        const retrax_layout *const layout = phase->layout;
        double *const trajectory = search->trial + phase->place;
        const retrax_index z = layout->count[RETRAX_ARRAY_PARTS], limits = phase->augmented.size - z;
        retrax_assemble_system(layout, trajectory, search->workspace, search->set);
        for (retrax_index i = 0; i < layout->problem->steps * limits; i++) {
            const retrax_index k = i / limits;
            write_row(layout, trajectory, k, limit_place(layout->problem, k, i % limits), phase->augmented.rows + i * z);
        }
    }
    const bool right = is_right(search, false, &clear);
    return right && (clear || (is_right(search, true, &clear) && clear));
}

/* Whether the linear system of the iterate has the inertia of a minimum without a shift. */
static bool has_right_inertia(retrax_search *search) {
    const retrax_direction step = search->direction;
    retrax_newton_step(search, 0.0);
    const bool found = search->direction.convex;
    search->direction = step;
    return found;
}

void retrax_conclude(retrax_search *search) {
    const retrax_direction *const step = &search->direction;
    const bool extremal = retrax_is_extremal(search);
    search->convex = extremal;
    EACH_PHASE(phase) { search->convex = search->convex && is_convex(phase, search->at + phase->place); }
    search->right_inertia = !extremal && search->trials > search->options.max_iterations && has_right_inertia(search);
    search->strict = extremal && search->isolated &&
                     (search->limited ? is_strict(search) : step->strict && step->shift == 0.0);
}
