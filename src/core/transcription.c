/*
 * Transcription: from the iterate of a trajectory to the linear system of a Newton step.
 */
#include "layout.h"

#include <math.h>
#include <string.h>

/* Ends of steps that are farther apart than this share of the largest entry of a column meet along an arc: a turn by 64
 * degrees. */
#define FAR 0.9
/* Largest half angle of such an arc, in radians: opposite points still have a direction. */
#define LARGEST_ANGLE (1.57079632679489661923 - 1e-2)

/* ------------------------------------------------------------------------------------------------- evaluation */

void retrax_evaluate_tape(void *context, const retrax_tape_data *data, retrax_index points) {
    const retrax_tape_function *const own = context;
    retrax_tape_run(own->tape, data, 0, points, own->registers, own->lanes, own->set);
}

/* Evaluates a function at `points` places of a trajectory. */
static void evaluate(const retrax_layout *layout, double *trajectory, retrax_function_name name,
                     retrax_index points) {
    const retrax_function *const own = &layout->problem->functions[name];
    const retrax_tape_data data = {trajectory, layout->numbers, layout->sources[name],
                                   trajectory, layout->numbers, layout->targets[name]};
    own->evaluate(own->context, &data, points);
}

static void copy(double *to, const double *from, retrax_index count) {
    memcpy(to, from, sizeof(double) * (size_t)count);
}

/* Writes the points and ends of the steps in their charts: xi_i = h sum_j A_ij nu_j, eta = h sum_j b_j nu_j. */
static void write_displacements(const retrax_layout *layout, double *trajectory) {
    const retrax_problem *const problem = layout->problem;
    const retrax_index s = problem->points, n = problem->state_size, E = problem->state_numbers;
    const double *const h = ARRAY(STEP_SIZE);
    for (retrax_index k = 0; k < problem->steps; k++) {
        const double *const velocities = ARRAY(VELOCITIES) + k * s * n;
        for (retrax_index i = 0; i <= s; i++) { /* the last one is the end */
            const double *const weights = i < s ? problem->matrix + i * s : problem->weights;
            double *const to = i < s ? ARRAY(XI) + (k * s + i) * n : ARRAY(ETA) + k * n;
            for (retrax_index a = 0; a < n; a++) {
                to[a] = 0.0;
                for (retrax_index j = 0; j < s; j++) {
                    to[a] += h[k] * weights[j] * velocities[j * n + a];
                }
            }
        }
        for (retrax_index i = 0; i < s; i++) {
            copy(ARRAY(POINT_CENTRES) + (k * s + i) * E, ARRAY(CENTRES) + k * E, E);
            ARRAY(POINT_WEIGHTS)[k * s + i] = h[k] * problem->weights[i];
        }
    }
}

/* The larger of both; a number that is NaN stays. */
static double larger(double a, double b) { return b > a || isnan(b) ? b : a; }

/* Meets the ends of two steps that are far apart at a point amid them: seen from one of them, an end beyond a quarter turn
 * would come nearer by turning away. `before`: the end of the step before the node.
 *
 * Each column runs along a circle. With half the chord r and the sagitta t of the node above its middle, half the angle of
 * the arc is 2 atan(t / r). The gap becomes that along the arc, of which a step sees the cosine of this angle. */
static void meet_amid(const retrax_layout *layout, double *trajectory, const double *before, retrax_index node) {
    const retrax_index E = layout->problem->state_numbers, *const columns = layout->problem->columns;
    double *const gap = ARRAY(GAPS) + node * E, *const seen = ARRAY(SEEN) + node * E, *const first = ARRAY(AMID);
    double *const second = first + E, *const middle = first + 2 * E;
    double *const sagittas = ARRAY(COLUMN_SIZES), *const chords = sagittas + E;
    bool finite = true;
    for (retrax_index e = 0; e < E; e++) {
        first[e] = before[e];
        second[e] = before[e] + gap[e];
        sagittas[e] = chords[e] = 0.0;
    }
    evaluate(layout, trajectory, RETRAX_MIDDLE, 1);
    for (retrax_index e = 0; e < E; e++) {
        finite = finite && isfinite(middle[e]);
    }
    for (retrax_index e = 0; e < E; e++) {
        const double at = finite ? middle[e] : first[e];
        const double sagitta = (first[e] + second[e]) / 2.0 - at, half = (second[e] - first[e]) / 2.0;
        sagittas[columns[e]] += sagitta * sagitta;
        chords[columns[e]] += half * half;
        ARRAY(NODES)[node * E + e] = at;
    }
    for (retrax_index e = 0; e < E; e++) {
        const double sagitta = sqrt(sagittas[columns[e]]), half = sqrt(chords[columns[e]]);
        const double angle = half > 0.0 ? fmin(2.0 * atan2(sagitta, half), LARGEST_ANGLE) : 0.0;
        const double arc = angle > 0.0 ? angle / sin(angle) : 1.0;
        seen[e] = gap[e] * arc * cos(angle);
        gap[e] *= arc;
    }
}

/* Whether a gap is far: a column of it is larger than FAR times the largest entry of that column along the nodes. */
static bool is_far(const double *gap, const double *largest, const retrax_index *columns, retrax_index E) {
    bool far = false;
    for (retrax_index e = 0; e < E; e++) {
        far = far || fabs(gap[e]) > FAR * largest[columns[e]];
    }
    return far;
}

/* Writes the nodes, and the gaps there: the beginning of the step behind a node minus the end of the step before. At the
 * first and the last node a prescribed entry takes the place of the step that is not there. */
static void write_nodes(const retrax_layout *layout, double *trajectory) {
    const retrax_index N = layout->problem->steps, E = layout->problem->state_numbers;
    const double *const begins = ARRAY(BEGINS), *const finishes = ARRAY(FINISHES);
    for (retrax_index k = 0; k <= N; k++) {
        for (retrax_index e = 0; e < E; e++) {
            double before = k > 0 ? finishes[(k - 1) * E + e] : begins[e];
            double after = k < N ? begins[k * E + e] : finishes[(k - 1) * E + e];
            if (k == 0 && ARRAY(START_ENTRIES)[e] != 0.0) {
                before = ARRAY(START)[e];
            }
            if (k == N && ARRAY(END_ENTRIES)[e] != 0.0) {
                after = ARRAY(END)[e];
            }
            ARRAY(NODES)[k * E + e] = k < N ? before : after;
            ARRAY(GAPS)[k * E + e] = after - before;
        }
    }
}

/* Writes the nodes where steps meet, and the gaps there; DISTANCE: the largest gaps along the chords. */
static void meet(const retrax_layout *layout, double *trajectory) {
    const retrax_index N = layout->problem->steps, E = layout->problem->state_numbers;
    const retrax_index *const columns = layout->problem->columns;
    double *const nodes = ARRAY(NODES), *const gaps = ARRAY(GAPS);
    double *const largest = ARRAY(LARGEST), *const distance = ARRAY(DISTANCE);
    write_nodes(layout, trajectory);
    memset(distance, 0, sizeof(double) * (size_t)E);
    memset(largest, 0, sizeof(double) * (size_t)E);
    for (retrax_index k = 0; k <= N; k++) {
        for (retrax_index e = 0; e < E; e++) {
            largest[columns[e]] = larger(largest[columns[e]], fabs(nodes[k * E + e]));
            distance[e] = larger(distance[e], fabs(gaps[k * E + e]));
        }
    }
    copy(ARRAY(SEEN), gaps, (N + 1) * E);
    for (retrax_index k = 0; k <= N; k++) {
        double *const node = nodes + k * E, *const gap = gaps + k * E;
        if (is_far(gap, largest, columns, E)) {
            for (retrax_index e = 0; e < E && k == N; e++) {
                node[e] -= gap[e]; /* the last node is the end of the trajectory, not that of its last step */
            }
            meet_amid(layout, trajectory, node, k);
        }
    }
}

/* Writes what a Newton step is asked to move the nodes by: the gaps that it sees, in the frames. */
static void write_asked(const retrax_layout *layout, double *trajectory) {
    const retrax_index n = layout->problem->state_size, E = layout->problem->state_numbers;
    for (retrax_index k = 0; k <= layout->problem->steps; k++) {
        for (retrax_index a = 0; a < n; a++) {
            const double *const direction = ARRAY(NODE_FRAMES) + (k * n + a) * E;
            double found = 0.0;
            for (retrax_index e = 0; e < E; e++) {
                found += direction[e] * ARRAY(SEEN)[k * E + e];
            }
            ARRAY(ASKED)[k * n + a] = ARRAY(FIXED)[k * n + a] * found;
        }
    }
}

retrax_end_cost retrax_end_cost_of(const retrax_layout *layout, const double *trajectory, bool of_end) {
    const retrax_problem *const problem = layout->problem;
    const retrax_index N = problem->steps, n = problem->state_size, E = problem->state_numbers;
    const retrax_index z = layout->count[RETRAX_ARRAY_PARTS], step = of_end ? N - 1 : 0;
    const double *const found = of_end ? ARRAY(END_COST) : ARRAY(START_COST);
    if (problem->functions[of_end ? RETRAX_END_COST : RETRAX_START_COST].evaluate == NULL) {
        return (retrax_end_cost){.value = 0.0};
    }
    return (retrax_end_cost){
        .value = found[0],
        .derivative = found + 1,
        .slope = found + 1 + E,
        .curvature = found + 1 + E + n,
        .node = of_end ? N : 0,
        .step = step,
        .end = (of_end ? ARRAY(RIGHT) : ARRAY(LEFT)) + step * n * z,
        .mended = retrax_collocates(problem) ? (of_end ? ARRAY(AFTER) : ARRAY(BEFORE)) + step * n : NULL,
        .sign = of_end ? 1.0 : -1.0,
    };
}

/* Adds the derivatives of the costs of the ends, times a sign, to covectors of the nodes. */
static void turn_covectors(const retrax_layout *layout, const double *trajectory, double sign, double *covectors) {
    const retrax_index E = layout->problem->state_numbers;
    for (int i = 0; i < 2; i++) {
        const retrax_end_cost cost = retrax_end_cost_of(layout, trajectory, i == 1);
        for (retrax_index e = 0; e < E && cost.derivative != NULL; e++) {
            covectors[cost.node * E + e] += sign * cost.sign * cost.derivative[e];
        }
    }
}

/* Evaluates the costs of the ends, where there are any. */
static void evaluate_end_costs(const retrax_layout *layout, double *trajectory) {
    for (int name = RETRAX_START_COST; name <= RETRAX_END_COST; name++) {
        if (layout->problem->functions[name].evaluate != NULL) {
            evaluate(layout, trajectory, (retrax_function_name)name, 1);
        }
    }
}

void retrax_evaluate_trajectory(const retrax_layout *layout, double *trajectory) {
    const retrax_index N = layout->problem->steps, s = layout->problem->points;
    if (retrax_collocates(layout->problem)) {
        write_displacements(layout, trajectory);
    }
    evaluate(layout, trajectory, RETRAX_ENDS, N);
    meet(layout, trajectory);
    evaluate_end_costs(layout, trajectory);
    copy(ARRAY(TURNED_COSTATES), ARRAY(COSTATES), layout->count[RETRAX_ARRAY_COSTATES]);
    turn_covectors(layout, trajectory, 1.0, ARRAY(TURNED_COSTATES));
    evaluate(layout, trajectory, RETRAX_FRAMES, N + 1);
    turn_covectors(layout, trajectory, -1.0, ARRAY(NODE_COSTATES));
    write_asked(layout, trajectory);
    evaluate(layout, trajectory, RETRAX_POINTS, N * s);
    if (retrax_collocates(layout->problem)) {
        evaluate(layout, trajectory, RETRAX_BOTH_ENDS, N);
    }
}

/* --------------------------------------------------------------------------------------------------- assembly */

/* The equations of the collocation points as condensing takes them; slope: of the Lagrangian with what is added to it. */
static retrax_collocation_system system_of(const retrax_layout *layout, double *trajectory, const double *slope) {
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
        .end_slope = ARRAY(END_SLOPES),
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
    const bool limited = problem->inequalities > 0;
    const retrax_collocation_system system =
        system_of(layout, trajectory, limited ? ARRAY(RIGHT_SLOPES) : ARRAY(POINT_SLOPES));
    retrax_condensed_system condensed = condensed_of(layout, trajectory);
    retrax_condense(&system, &condensed, 0, problem->steps, workspace, set);
    if (limited) {
        retrax_condense_slope(&system, &condensed, ARRAY(BARRIER_SLOPES), NULL, ARRAY(SLOPES_BY_VELOCITIES),
                              ARRAY(BARRIER_SIDES));
    }
    retrax_condense_slope(&system, &condensed, ARRAY(POINT_SLOPES), ARRAY(END_SLOPES), ARRAY(SLOPES_BY_VELOCITIES),
                          ARRAY(SLOPES));
    retrax_condense_slope(&system, &condensed, ARRAY(POINT_GRADIENTS), NULL, ARRAY(GRADIENTS_BY_VELOCITIES),
                          ARRAY(GRADIENTS));
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
            ARRAY(COSTS)[k] = 0.0;
            for (retrax_index i = 0; i < s; i++) {
                ARRAY(COSTS)[k] += ARRAY(POINT_COSTS)[k * s + i];
            }
        }
    } else if (problem->inequalities == 0) {
        copy(ARRAY(RIGHT_SIDES), ARRAY(SLOPES), layout->count[RETRAX_ARRAY_SLOPES]);
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
    copy(defects, ARRAY(ASKED), count[RETRAX_ARRAY_ASKED]);
    for (retrax_index i = 0; i < count[RETRAX_ARRAY_BEFORE]; i++) {
        defects[i] += ARRAY(BEFORE)[i];
        defects[n + i] -= ARRAY(AFTER)[i];
    }
}

/* Writes the steps of the covectors at the nodes: of the multipliers, and at the ends of the slopes of their costs. */
static void write_covector_steps(const retrax_layout *layout, double *trajectory) {
    const retrax_index n = layout->problem->state_size, z = layout->count[RETRAX_ARRAY_PARTS];
    copy(ARRAY(COVECTOR_STEPS), ARRAY(MULTIPLIER_STEPS), layout->count[RETRAX_ARRAY_MULTIPLIER_STEPS]);
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
    const bool limited = layout->problem->inequalities > 0;
    const retrax_collocation_system system =
        system_of(layout, trajectory, limited ? ARRAY(NEWTON_SLOPES) : ARRAY(POINT_SLOPES));
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
    evaluate(layout, trajectory, RETRAX_MOVE, N);
    evaluate(layout, trajectory, RETRAX_MOVE_CONTROLS, N * s);
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
    copy(ARRAY(CENTRES_BEFORE), from + layout->first[RETRAX_ARRAY_CENTRES], layout->count[RETRAX_ARRAY_CENTRES]);
    copy(ARRAY(CONTROLS_BEFORE), from + layout->first[RETRAX_ARRAY_CONTROLS], layout->count[RETRAX_ARRAY_CONTROLS]);
    if (retrax_collocates(problem)) {
        move_collocation(layout, from, part, trajectory);
    } else {
        write_parts(ARRAY(CENTRE_PARTS), from + layout->first[RETRAX_ARRAY_STEPS], part, layout->count[RETRAX_ARRAY_STEPS]);
        evaluate(layout, trajectory, RETRAX_MOVE, problem->steps);
    }
    write_covectors(ARRAY(COSTATES), from + layout->first[RETRAX_ARRAY_NODE_FRAMES],
                    from + layout->first[RETRAX_ARRAY_MULTIPLIERS], from + layout->first[RETRAX_ARRAY_COVECTOR_STEPS], part,
                    problem->steps + 1, problem->state_size, problem->state_numbers);
    turn_covectors(layout, from, -1.0, ARRAY(COSTATES));
}
