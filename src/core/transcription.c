/*
 * Transcription: from the unknowns of a trajectory to the values of the functions of its problem.
 */
#include "layout.h"

#include <math.h>
#include <string.h>

/* Ends of steps that are farther apart than this share of the largest entry of a column meet along an arc: a turn by 64
 * degrees. */
#define FAR_APART 0.9
/* Largest half angle of such an arc, in radians: opposite points still have a direction. */
#define LARGEST_ANGLE (1.57079632679489661923 - 1e-2)

/* ------------------------------------------------------------------------------------------------- evaluation */

void retrax_evaluate_tape(void *context, const retrax_tape_data *data, retrax_index points) {
    const retrax_tape_function *const own = context;
    retrax_tape_run(own->tape, data, 0, points, own->registers, own->lanes, own->set);
}

void retrax_evaluate_function(const retrax_layout *layout, double *trajectory, retrax_function_name name,
                     retrax_index points) {
    const retrax_function *const own = &layout->problem->functions[name];
    const retrax_tape_data data = {trajectory, layout->numbers, layout->sources[name],
                                   trajectory, layout->numbers, layout->targets[name]};
    own->evaluate(own->context, &data, points);
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
            retrax_copy(ARRAY(POINT_CENTRES) + (k * s + i) * E, ARRAY(CENTRES) + k * E, E);
            ARRAY(POINT_WEIGHTS)[k * s + i] = h[k] * problem->weights[i];
        }
    }
}

/* Meets the ends of two steps that are far apart at a point amid them: seen from one of them, an end beyond a quarter
 * turn would come nearer by turning away. `before`: the end of the step before the node.
 *
 * Each column runs along a circle. With half the chord r and the sagitta t of the node above its middle, half the angle
 * of the arc is 2 atan(t / r). The gap becomes that along the arc, of which a step sees the cosine of this angle. */
static void meet_amid(const retrax_layout *layout, double *trajectory, const double *before, retrax_index node) {
    const retrax_index E = layout->problem->state_numbers, *const columns = layout->problem->columns;
    double *const gap = ARRAY(GAPS) + node * E, *const seen = ARRAY(SEEN) + node * E, *const first = ARRAY(AMID_ENDS);
    double *const second = first + E, *const middle = ARRAY(AMID);
    double *const sagittas = ARRAY(COLUMN_SIZES), *const chords = sagittas + E;
    bool finite = true;
    for (retrax_index e = 0; e < E; e++) {
        first[e] = before[e];
        second[e] = before[e] + gap[e];
        sagittas[e] = chords[e] = 0.0;
    }
    retrax_evaluate_function(layout, trajectory, RETRAX_MIDDLE, 1);
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

/* Whether a gap is far: a column of it is larger than FAR_APART times the largest entry of that column along the nodes. */
static bool is_far(const double *gap, const double *largest, const retrax_index *columns, retrax_index E) {
    bool far = false;
    for (retrax_index e = 0; e < E; e++) {
        far = far || fabs(gap[e]) > FAR_APART * largest[columns[e]];
    }
    return far;
}

/* Writes the nodes, and the gaps there: the beginning of the step behind a node minus the end of the step before. At
 * the first and the last node a prescribed entry takes the place of the step that is not there. */
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
            largest[columns[e]] = retrax_larger(largest[columns[e]], fabs(nodes[k * E + e]));
            distance[e] = retrax_larger(distance[e], fabs(gaps[k * E + e]));
        }
    }
    retrax_copy(ARRAY(SEEN), gaps, (N + 1) * E);
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
    if (!problem->coupled && problem->functions[of_end ? RETRAX_END_COST : RETRAX_START_COST].evaluate == NULL) {
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

void retrax_turn_covectors(const retrax_layout *layout, const double *trajectory, double sign, double *covectors) {
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
        if (!layout->problem->coupled && layout->problem->functions[name].evaluate != NULL) {
            retrax_evaluate_function(layout, trajectory, (retrax_function_name)name, 1);
        }
    }
}

void retrax_evaluate_nodes(const retrax_layout *layout, double *trajectory) {
    if (retrax_collocates(layout->problem)) {
        write_displacements(layout, trajectory);
    }
    retrax_evaluate_function(layout, trajectory, RETRAX_ENDS, layout->problem->steps);
    meet(layout, trajectory);
}

void retrax_evaluate_points(const retrax_layout *layout, double *trajectory) {
    const retrax_index N = layout->problem->steps, s = layout->problem->points;
    evaluate_end_costs(layout, trajectory);
    retrax_copy(ARRAY(TURNED_COSTATES), ARRAY(COSTATES), layout->count[RETRAX_ARRAY_COSTATES]);
    retrax_turn_covectors(layout, trajectory, 1.0, ARRAY(TURNED_COSTATES));
    retrax_evaluate_function(layout, trajectory, RETRAX_FRAMES, N + 1);
    retrax_turn_covectors(layout, trajectory, -1.0, ARRAY(NODE_COSTATES));
    write_asked(layout, trajectory);
    retrax_evaluate_function(layout, trajectory, RETRAX_POINTS, N * s);
    if (retrax_collocates(layout->problem)) {
        retrax_evaluate_function(layout, trajectory, RETRAX_BOTH_ENDS, N);
    }
    if (layout->problem->curved_controls) {
        retrax_evaluate_function(layout, trajectory, RETRAX_CONTROL_FRAMES, N * s);
    }
}

void retrax_evaluate_trajectory(const retrax_layout *layout, double *trajectory) {
    retrax_evaluate_nodes(layout, trajectory);
    retrax_evaluate_points(layout, trajectory);
}
