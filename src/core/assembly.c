/*
 * Assembly: from the values of the functions to the linear system of a Newton step, and from a step to the next iterate.
 */
#include "layout.h"

#include <string.h>

/* The equations of the collocation points as condensing takes them; slope, end_slope: of the Lagrangian with what is
 * added to them. */
static retrax_collocation_system system_of(const retrax_layout *layout, double *trajectory, const double *slope,
                                            const double *end_slope) {
    const retrax_problem *const problem = layout->problem;
    return (retrax_collocation_system){
        .steps = problem->steps,
        .points = problem->points,
        .state_size = problem->state_size,
        .control_size = problem->control_size,
        .columns = 1,
        .step_size = ARRAY(STEP_SIZE),
        .matrix = problem->matrix,
        .weights = problem->weights,
        .hessian = ARRAY(POINT_HESSIANS),
        .jacobian = ARRAY(POINT_JACOBIANS),
        .slope = slope,
        .defect = ARRAY(POINT_DEFECTS),
        .end_hessian = ARRAY(END_HESSIANS),
        .end_left = ARRAY(END_LEFT),
        .end_right = ARRAY(END_RIGHT),
        .end_slope = end_slope,
    };
}

/* What condensing leaves of them. */
static retrax_condensed_system condensed_of(const retrax_layout *layout, double *trajectory) {
    return (retrax_condensed_system){
        .hessian = ARRAY(HESSIANS),
        .left = ARRAY(LEFT),
        .right = ARRAY(RIGHT),
        .slope = ARRAY(RIGHT_SIDES),
        .before = ARRAY(BEFORE),
        .after = ARRAY(AFTER),
        .factors = ARRAY(FACTORS),
        .swaps = (retrax_index *)ARRAY(SWAPS),
        .velocities = ARRAY(VELOCITY_MAPS),
    };
}

/* Condenses the collocation steps; the velocities that mend the defects of the points change slopes and ends. */
static void condense(const retrax_layout *layout, double *trajectory, void *workspace, retrax_instruction_set set) {
    const retrax_problem *const problem = layout->problem;
    const bool has_inequalities = retrax_has_inequalities(problem), at_nodes = problem->node_inequalities > 0;
    const retrax_collocation_system system =
        system_of(layout, trajectory, has_inequalities ? ARRAY(RIGHT_SLOPES) : ARRAY(POINT_SLOPES),
                  at_nodes ? ARRAY(RIGHT_END_SLOPES) : ARRAY(END_SLOPES));
    retrax_condensed_system condensed = condensed_of(layout, trajectory);
    retrax_condense(&system, &condensed, 0, problem->steps, workspace, set);
    if (has_inequalities) {
        retrax_condense_slope(&system, &condensed, ARRAY(BARRIER_SLOPES), at_nodes ? ARRAY(BARRIER_END_SLOPES) : NULL,
                              ARRAY(SLOPES_BY_VELOCITIES),
                              ARRAY(BARRIER_SIDES));
    }
    retrax_condense_slope(&system, &condensed, ARRAY(POINT_SLOPES), ARRAY(END_SLOPES), ARRAY(SLOPES_BY_VELOCITIES),
                          ARRAY(SLOPES));
    retrax_condense_slope(&system, &condensed, ARRAY(POINT_GRADIENTS), problem->node_costs > 0 ? ARRAY(END_GRADIENTS) : NULL,
                          ARRAY(GRADIENTS_BY_VELOCITIES), ARRAY(GRADIENTS));
}

/* Adds the cost of an end to the blocks of the step there. */
static void add_end_cost(const retrax_layout *layout, double *trajectory, const retrax_end_cost *cost) {
    const retrax_index n = layout->problem->state_size, z = layout->count[RETRAX_ARRAY_PARTS];
    double *const hessian = ARRAY(HESSIANS) + cost->step * z * z, *const gradient = ARRAY(GRADIENTS) + cost->step * z;
    double *const side = ARRAY(RIGHT_SIDES) + cost->step * z;
    for (retrax_index a = 0; a < n; a++) {
        const double *const row = cost->end + a * z;
        for (retrax_index i = 0; i < z; i++) {
            gradient[i] += cost->slope[a] * row[i];
        }
        for (retrax_index b = 0; b < n; b++) {
            const double curvature = cost->curvature[a * n + b], *const other = cost->end + b * z;
            for (retrax_index i = 0; i < z; i++) {
                side[i] += cost->mended == NULL ? 0.0 : row[i] * curvature * cost->mended[b];
                for (retrax_index j = 0; j < z; j++) {
                    hessian[i * z + j] += row[i] * curvature * other[j];
                }
            }
        }
    }
}

void retrax_assemble_system(const retrax_layout *layout, double *trajectory, void *workspace,
                            retrax_instruction_set set) {
    const retrax_problem *const problem = layout->problem;
    const retrax_index s = problem->points;
    if (retrax_collocates(problem)) {
        condense(layout, trajectory, workspace, set);
        for (retrax_index k = 0; k < problem->steps; k++) {
            ARRAY(COSTS)[k] = problem->node_costs > 0 ? ARRAY(END_COSTS)[k] : 0.0;
            for (retrax_index i = 0; i < s; i++) {
                ARRAY(COSTS)[k] += ARRAY(POINT_COSTS)[k * s + i];
            }
        }
    } else if (!retrax_has_inequalities(problem)) {
        retrax_copy(ARRAY(RIGHT_SIDES), ARRAY(SLOPES), layout->count[RETRAX_ARRAY_SLOPES]);
    }
    for (int i = 0; i < 2; i++) {
        const retrax_end_cost cost = retrax_end_cost_of(layout, trajectory, i == 1);
        if (cost.derivative != NULL) {
            add_end_cost(layout, trajectory, &cost);
        }
    }
}

/* ----------------------------------------------------------------------------------------------- Newton's step */

/* to = first + barrier * second, or first where there is no second. */
static void drive(double *to, const double *first, const double *second, double barrier, retrax_index count,
                  retrax_index driven) {
    for (retrax_index i = 0; i < count; i++) {
        to[i] = first[i] + (driven > 0 ? barrier * second[i] : 0.0);
    }
}

void retrax_write_right_sides(const retrax_layout *layout, double *trajectory) {
    const retrax_index *const count = layout->count, n = layout->problem->state_size;
    const double barrier = *ARRAY(BARRIER);
    double *const defects = ARRAY(NEWTON_DEFECTS);
    drive(ARRAY(NEWTON_SIDES), ARRAY(RIGHT_SIDES), ARRAY(BARRIER_SIDES), barrier, count[RETRAX_ARRAY_NEWTON_SIDES],
          count[RETRAX_ARRAY_BARRIER_SIDES]);
    drive(ARRAY(NEWTON_SLOPES), ARRAY(RIGHT_SLOPES), ARRAY(BARRIER_SLOPES), barrier, count[RETRAX_ARRAY_NEWTON_SLOPES],
          count[RETRAX_ARRAY_BARRIER_SLOPES]);
    drive(ARRAY(NEWTON_END_SLOPES), ARRAY(RIGHT_END_SLOPES), ARRAY(BARRIER_END_SLOPES), barrier,
          count[RETRAX_ARRAY_NEWTON_END_SLOPES], count[RETRAX_ARRAY_BARRIER_END_SLOPES]);
    retrax_copy(defects, ARRAY(ASKED), count[RETRAX_ARRAY_ASKED]);
    for (retrax_index i = 0; i < count[RETRAX_ARRAY_BEFORE]; i++) {
        defects[i] += ARRAY(BEFORE)[i];
        defects[n + i] -= ARRAY(AFTER)[i];
    }
}

/* Writes the steps of the covectors at the nodes: of the multipliers, and at the ends of the slopes of their costs. */
static void write_covector_steps(const retrax_layout *layout, double *trajectory) {
    const retrax_index n = layout->problem->state_size, z = layout->count[RETRAX_ARRAY_PARTS];
    retrax_copy(ARRAY(COVECTOR_STEPS), ARRAY(MULTIPLIER_STEPS), layout->count[RETRAX_ARRAY_MULTIPLIER_STEPS]);
    for (int i = 0; i < 2; i++) {
        const retrax_end_cost cost = retrax_end_cost_of(layout, trajectory, i == 1);
        for (retrax_index b = 0; b < n && cost.derivative != NULL; b++) {
            double moved = cost.mended == NULL ? 0.0 : cost.mended[b];
            for (retrax_index j = 0; j < z; j++) {
                moved += cost.end[b * z + j] * ARRAY(STEPS)[cost.step * z + j];
            }
            for (retrax_index a = 0; a < n; a++) {
                ARRAY(COVECTOR_STEPS)[cost.node * n + a] -= cost.sign * cost.curvature[a * n + b] * moved;
            }
        }
    }
}

void retrax_expand_step(const retrax_layout *layout, double *trajectory, void *workspace) {
    write_covector_steps(layout, trajectory);
    if (!retrax_collocates(layout->problem)) {
        return;
    }
    const bool has_inequalities = retrax_has_inequalities(layout->problem), at_nodes = layout->problem->node_inequalities > 0;
    const retrax_collocation_system system =
        system_of(layout, trajectory, has_inequalities ? ARRAY(NEWTON_SLOPES) : ARRAY(POINT_SLOPES),
                  at_nodes ? ARRAY(NEWTON_END_SLOPES) : ARRAY(END_SLOPES));
    const retrax_condensed_system condensed = condensed_of(layout, trajectory);
    retrax_expand(&system, &condensed, 0, layout->problem->steps, ARRAY(STEPS), ARRAY(COVECTOR_STEPS),
                  ARRAY(VELOCITY_STEPS), ARRAY(POINT_MULTIPLIER_STEPS), workspace);
}

/* Writes covectors with coordinates c + part * d in frames of n directions. */
static void write_covectors(double *to, const double *frames, const double *coordinates, const double *steps,
                            double part, retrax_index count, retrax_index n, retrax_index E) {
    for (retrax_index k = 0; k < count; k++) {
        for (retrax_index e = 0; e < E; e++) {
            double found = 0.0;
            for (retrax_index a = 0; a < n; a++) {
                found += (coordinates[k * n + a] + part * steps[k * n + a]) * frames[(k * n + a) * E + e];
            }
            to[k * E + e] = found;
        }
    }
}

static void write_parts(double *to, const double *from, double part, retrax_index count) {
    for (retrax_index i = 0; i < count; i++) {
        to[i] = part * from[i];
    }
}

/* Moves the unknowns of collocation steps: velocities are carried to the frames at the moved centres. */
static void move_collocation(const retrax_layout *layout, const double *from, double part, double *trajectory) {
    const retrax_problem *const problem = layout->problem;
    const retrax_index N = problem->steps, s = problem->points, n = problem->state_size, E = problem->state_numbers;
    const retrax_index m = problem->control_size, z = n + s * m;
    const double *const steps = from + layout->first[RETRAX_ARRAY_STEPS];
    for (retrax_index k = 0; k < N; k++) {
        write_parts(ARRAY(CENTRE_PARTS) + k * n, steps + k * z, part, n);
        write_parts(ARRAY(CONTROL_PARTS) + k * s * m, steps + k * z + n, part, s * m);
    }
    retrax_evaluate_function(layout, trajectory, RETRAX_MOVE, N);
    retrax_evaluate_function(layout, trajectory, RETRAX_MOVE_CONTROLS, N * s);
    for (retrax_index k = 0; k < N * s; k++) {
        const double *const carried = ARRAY(CARRIED) + k / s * n * n;
        const double *const velocity = from + layout->first[RETRAX_ARRAY_VELOCITIES] + k * n;
        const double *const step = from + layout->first[RETRAX_ARRAY_VELOCITY_STEPS] + k * n;
        for (retrax_index a = 0; a < n; a++) {
            double found = 0.0;
            for (retrax_index b = 0; b < n; b++) {
                found += carried[a * n + b] * (velocity[b] + part * step[b]);
            }
            ARRAY(VELOCITIES)[k * n + a] = found;
        }
    }
    write_covectors(ARRAY(POINT_COSTATES), from + layout->first[RETRAX_ARRAY_POINT_FRAMES],
                    from + layout->first[RETRAX_ARRAY_POINT_MULTIPLIERS],
                    from + layout->first[RETRAX_ARRAY_POINT_MULTIPLIER_STEPS], part, N * s, n, E);
}

void retrax_move_trajectory(const retrax_layout *layout, const double *from, double part, double *trajectory) {
    const retrax_problem *const problem = layout->problem;
    retrax_copy(ARRAY(CENTRES_BEFORE), from + layout->first[RETRAX_ARRAY_CENTRES], layout->count[RETRAX_ARRAY_CENTRES]);
    retrax_copy(ARRAY(CONTROLS_BEFORE), from + layout->first[RETRAX_ARRAY_CONTROLS], layout->count[RETRAX_ARRAY_CONTROLS]);
    if (retrax_collocates(problem)) {
        move_collocation(layout, from, part, trajectory);
    } else {
        write_parts(ARRAY(CENTRE_PARTS), from + layout->first[RETRAX_ARRAY_STEPS], part, layout->count[RETRAX_ARRAY_STEPS]);
        retrax_evaluate_function(layout, trajectory, RETRAX_MOVE, problem->steps);
    }
    write_covectors(ARRAY(COSTATES), from + layout->first[RETRAX_ARRAY_NODE_FRAMES],
                    from + layout->first[RETRAX_ARRAY_MULTIPLIERS], from + layout->first[RETRAX_ARRAY_COVECTOR_STEPS], part,
                    problem->steps + 1, problem->state_size, problem->state_numbers);
    retrax_turn_covectors(layout, from, -1.0, ARRAY(COSTATES));
}
