/*
 * Residuals: how far a trajectory is from satisfying its conditions, relative to what these are made of.
 *
 * An entry of a gap is measured by the spread of the trajectory in it, or by a share of its value, or of its unit. The
 * derivative of the Lagrangian is measured by the parts that cancel in it, coordinate by coordinate; where all parts
 * vanish, as the costates do at an optimum of the cost itself, by its curvature.
 */
#include "search.h"

#include <math.h>
#include <string.h>

static void fill(double *to, double value, retrax_index count) {
    for (retrax_index i = 0; i < count; i++) {
        to[i] = value;
    }
}

/* Surveys states and frames of the nodes, and what the nodes lack. */
static void survey_nodes(const retrax_layout *layout, double *trajectory) {
    const retrax_index n = layout->problem->state_size, E = layout->problem->state_numbers;
    for (retrax_index k = 0; k <= layout->problem->steps; k++) {
        const double *const node = ARRAY(NODES) + k * E, *const frame = ARRAY(NODE_FRAMES) + k * n * E;
        for (retrax_index e = 0; e < E; e++) {
            ARRAY(HIGHEST)[e] = retrax_larger(ARRAY(HIGHEST)[e], node[e]);
            ARRAY(LOWEST)[e] = retrax_larger(ARRAY(LOWEST)[e], -node[e]);
        }
        for (retrax_index i = 0; i < n * E; i++) {
            ARRAY(SUPPORT)[i] = retrax_larger(ARRAY(SUPPORT)[i], fabs(frame[i]));
        }
        for (retrax_index a = 0; a < n; a++) {
            const double defect = ARRAY(DEFECTS)[k * n + a];
            ARRAY(SUMMED_DEFECTS)[a] += fabs(defect);
            ARRAY(MAX_DEFECTS)[a] = retrax_larger(ARRAY(MAX_DEFECTS)[a], fabs(defect));
            ARRAY(TOTALS)[1] += ARRAY(MULTIPLIERS)[k * n + a] * defect;
        }
    }
}

/* Surveys the slopes of the Lagrangian by the unknowns of the steps, the parts that cancel in them, and the
 * curvatures. */
static void survey_steps(const retrax_layout *layout, double *trajectory) {
    const retrax_index n = layout->problem->state_size, z = layout->count[RETRAX_ARRAY_PARTS];
    for (retrax_index k = 0; k < layout->problem->steps; k++) {
        const double *const before = ARRAY(MULTIPLIERS) + k * n, *const after = before + n;
        for (retrax_index i = 0; i < z; i++) {
            double left = 0.0, right = 0.0;
            for (retrax_index a = 0; a < n; a++) {
                left += before[a] * ARRAY(LEFT)[(k * n + a) * z + i];
                right += after[a] * ARRAY(RIGHT)[(k * n + a) * z + i];
            }
            const double parts = fabs(ARRAY(GRADIENTS)[k * z + i]) + (fabs(left) + fabs(right));
            ARRAY(PARTS)[i] = retrax_larger(ARRAY(PARTS)[i], parts);
            ARRAY(LARGEST_SLOPES)[i] = retrax_larger(ARRAY(LARGEST_SLOPES)[i], fabs(ARRAY(SLOPES)[k * z + i]));
            ARRAY(CURVATURES)[i] = retrax_larger(ARRAY(CURVATURES)[i], fabs(ARRAY(HESSIANS)[(k * z + i) * z + i]));
        }
        ARRAY(TOTALS)[0] += ARRAY(COSTS)[k];
    }
}

/* The sum of the sizes of what the slope of the Lagrangian by an unknown of a collocation point is made of. */
static double point_parts(const retrax_layout *layout, const double *trajectory, retrax_index point, retrax_index i) {
    const retrax_index n = layout->problem->state_size, q = retrax_point_unknowns(layout->problem);
    double found = fabs(ARRAY(POINT_GRADIENTS)[point * q + i]);
    for (retrax_index c = point * n; c < (point + 1) * n; c++) {
        found += fabs(ARRAY(POINT_MULTIPLIERS)[c] * ARRAY(POINT_JACOBIANS)[c * q + i]);
    }
    return found;
}

/* The same by coordinate a of the velocity of a point: through the far end of its step, through all points of the step,
 * which matter most where a step is stiff, and by itself. */
static double velocity_parts(const retrax_layout *layout, const double *trajectory, retrax_index point, retrax_index a) {
    const retrax_problem *const problem = layout->problem;
    const retrax_index s = problem->points, n = problem->state_size, k = point / s, i = point % s;
    const double *const left = ARRAY(END_LEFT) + k * 2 * n * n, *const right = ARRAY(END_RIGHT) + k * 2 * n * n;
    double end = 0.0, within = 0.0;
    for (retrax_index c = 0; c < n; c++) {
        end += fabs(left[c * 2 * n + n + a] * ARRAY(MULTIPLIERS)[k * n + c]);
        end += fabs(right[c * 2 * n + n + a] * ARRAY(MULTIPLIERS)[(k + 1) * n + c]);
    }
    for (retrax_index j = 0; j < s; j++) {
        within += fabs(problem->matrix[j * s + i]) * point_parts(layout, trajectory, k * s + j, n + a);
    }
    const double by_place = fabs(ARRAY(STEP_SIZE)[k]) * (fabs(problem->weights[i]) * end + within);
    return by_place + point_parts(layout, trajectory, point, 2 * n + a);
}

/* Surveys what the points of collocation steps lack. */
static void survey_points(const retrax_layout *layout, double *trajectory) {
    const retrax_index s = layout->problem->points, n = layout->problem->state_size;
    double *const found = ARRAY(POINT_SURVEY);
    for (retrax_index k = 0; k < layout->problem->steps; k++) {
        for (retrax_index a = 0; a < n; a++) {
            double total = 0.0;
            for (retrax_index i = k * s; i < (k + 1) * s; i++) {
                const double defect = ARRAY(POINT_DEFECTS)[i * n + a], multiplier = ARRAY(POINT_MULTIPLIERS)[i * n + a];
                const double weight = ARRAY(POINT_WEIGHTS)[i], slope = fabs(ARRAY(SLOPES_BY_VELOCITIES)[i * n + a]) / weight;
                const double parts = velocity_parts(layout, trajectory, i, a) / weight;
                total += fabs(defect);
                found[RETRAX_POINTS_OF_POINT * n + a] = retrax_larger(found[RETRAX_POINTS_OF_POINT * n + a], fabs(defect));
                found[RETRAX_POINTS_PARTS * n + a] = retrax_larger(found[RETRAX_POINTS_PARTS * n + a], parts);
                found[RETRAX_POINTS_SLOPE * n + a] = retrax_larger(found[RETRAX_POINTS_SLOPE * n + a], slope);
                ARRAY(TOTALS)[1] += multiplier * defect;
            }
            found[RETRAX_POINTS_OF_STEP * n + a] = retrax_larger(found[RETRAX_POINTS_OF_STEP * n + a], total);
            found[RETRAX_POINTS_TOTAL * n + a] += total;
        }
    }
}

void retrax_survey_trajectory(const retrax_layout *layout, double *trajectory) {
    static const retrax_array sums[] = {RETRAX_ARRAY_SUPPORT,        RETRAX_ARRAY_SUMMED_DEFECTS,    RETRAX_ARRAY_MAX_DEFECTS,
                                        RETRAX_ARRAY_PARTS,          RETRAX_ARRAY_LARGEST_SLOPES,
                                        RETRAX_ARRAY_CURVATURES,     RETRAX_ARRAY_POINT_SURVEY, RETRAX_ARRAY_TOTALS};
    for (size_t i = 0; i < sizeof(sums) / sizeof(sums[0]); i++) {
        fill(trajectory + layout->first[sums[i]], 0.0, layout->count[sums[i]]);
    }
    fill(ARRAY(HIGHEST), -INFINITY, layout->problem->state_numbers);
    fill(ARRAY(LOWEST), -INFINITY, layout->problem->state_numbers);
    survey_nodes(layout, trajectory);
    survey_steps(layout, trajectory);
    ARRAY(TOTALS)[0] += retrax_end_cost_of(layout, trajectory, false).value;
    ARRAY(TOTALS)[0] += retrax_end_cost_of(layout, trajectory, true).value;
    if (retrax_collocates(layout->problem)) {
        survey_points(layout, trajectory);
    }
}

bool retrax_is_alone(const double *support, retrax_index n, retrax_index E, retrax_index entry) {
    retrax_index owner = 0, owners = 0, moved = 0;
    for (retrax_index a = 0; a < n; a++) {
        if (support[a * E + entry] > 0.0) {
            owner = a;
            owners++;
        }
    }
    for (retrax_index e = 0; e < E && owners == 1; e++) {
        moved += support[owner * E + e] > 0.0;
    }
    return moved == 1;
}

void retrax_measure_motion(const retrax_layout *layout, const double *trajectory, double *work, double *moved,
                           double *sizes) {
    const retrax_index n = layout->problem->state_size, E = layout->problem->state_numbers;
    const retrax_index *const columns = layout->problem->columns;
    const double *const support = ARRAY(SUPPORT);
    double *const own = work, *const of_columns = work + E; /* sizes that an entry is beside; of the columns */
    memset(of_columns, 0, sizeof(double) * (size_t)E);
    for (retrax_index e = 0; e < E; e++) {
        const double value = retrax_larger(ARRAY(HIGHEST)[e], ARRAY(LOWEST)[e]);
        of_columns[columns[e]] = retrax_larger(of_columns[columns[e]], value);
    }
    for (retrax_index e = 0; e < E; e++) {
        own[e] = retrax_is_alone(support, n, E, e) ? 0.0 : of_columns[columns[e]];
    }
    for (retrax_index a = 0; a < n; a++) {
        double far = 0.0, most = 0.0, whole = 0.0;
        for (retrax_index e = 0; e < E; e++) {
            const double high = ARRAY(HIGHEST)[e], low = ARRAY(LOWEST)[e], share = support[a * E + e];
            const double value = retrax_larger(high, low);
            if (high + low > RETRAX_STILL * value) {
                far = retrax_larger(far, share * (high + low));
            }
            whole = retrax_larger(whole, share * own[e]);
            most = retrax_larger(most, share * retrax_larger(value, own[e]));
        }
        moved[a] = far > RETRAX_ROOT_EPS * whole ? far : 0.0;
        sizes[a] = most;
    }
}

/* Writes by what gaps are measured, ALONG the coordinates of the nodes and in their ENTRIES. */
static void write_measures(const retrax_layout *layout, double *trajectory, const double *nodes) {
    const retrax_index n = layout->problem->state_size, E = layout->problem->state_numbers;
    double *const along = ARRAY(ALONG), *const entries = ARRAY(ENTRIES);
    const double *const support = ARRAY(SUPPORT);
    for (retrax_index a = 0; a < n; a++) {
        along[a] = 0.0;
        for (retrax_index e = 0; e < E; e++) {
            along[a] = retrax_larger(along[a], support[a * E + e]);
        }
    }
    for (retrax_index e = 0; e < E; e++) {
        const double high = ARRAY(HIGHEST)[e], low = ARRAY(LOWEST)[e];
        double value = retrax_larger(high, low);
        bool moves = false;
        for (retrax_index a = 0; a < n; a++) {
            moves = moves || support[a * E + e] > RETRAX_ROOT_EPS * along[a];
        }
        if (!moves) { /* the equations of the manifold say what it is, and hold to a share of one */
            value = retrax_larger(value, 1.0);
        }
        entries[e] = retrax_larger(high + low, RETRAX_VALUE_SHARE * value);
    }
    for (retrax_index a = 0; a < n; a++) {
        along[a] = RETRAX_SHARE * nodes[a];
        for (retrax_index e = 0; e < E; e++) {
            along[a] = retrax_larger(along[a], support[a * E + e] * entries[e]);
        }
    }
    for (retrax_index e = 0; e < E; e++) {
        for (retrax_index a = 0; a < n; a++) {
            entries[e] = retrax_larger(entries[e], support[a * E + e] * along[a]);
        }
    }
}

/* The derivative of the Lagrangian by the unknowns of the steps relative to its parts, and the scale of these. */
static double stationarity_of(const retrax_layout *layout, const double *trajectory, const retrax_residual_scale *units,
                              double *scale) {
    const retrax_index n = layout->problem->state_size, z = layout->count[RETRAX_ARRAY_PARTS];
    double found = 0.0;
    *scale = units->least_part;
    for (retrax_index i = 0; i < z; i++) {
        const double unit = units->judging_unknowns[i], reach = i < n ? retrax_larger(unit, ARRAY(ALONG)[i]) : unit;
        *scale = retrax_larger(*scale, unit * ARRAY(PARTS)[i]);
        if (units->least_part == 0.0) {
            *scale = retrax_larger(*scale, unit * reach * ARRAY(CURVATURES)[i]);
        }
    }
    for (retrax_index i = 0; i < z; i++) {
        const double unit = units->judging_unknowns[i];
        found = retrax_larger(found, ARRAY(LARGEST_SLOPES)[i] * unit / retrax_or_one(retrax_larger(unit * ARRAY(PARTS)[i], RETRAX_SHARE * *scale)));
    }
    return found;
}

double retrax_span_of(const retrax_layout *layout, const double *trajectory, retrax_index i) {
    const retrax_index n = layout->problem->state_size, E = layout->problem->state_numbers;
    double found = i < n ? 0.0 : retrax_control_size(layout, trajectory, i - n);
    for (retrax_index e = 0; e < E && i < n; e++) {
        const double high = ARRAY(HIGHEST)[e], low = ARRAY(LOWEST)[e];
        const double size = retrax_larger(high + low, RETRAX_VALUE_SHARE * retrax_larger(high, low));
        found = retrax_larger(found, ARRAY(SUPPORT)[i * E + e] * size);
    }
    return found;
}

/* The largest curvature of the Lagrangian by an unknown of the steps, other than through what follows of it: of a step
 * whose points are condensed, that by the unknown of a point itself. */
static double own_curvature(const retrax_layout *layout, const double *trajectory, retrax_index i) {
    const retrax_problem *const problem = layout->problem;
    const retrax_index n = problem->state_size, m = problem->control_size, q = retrax_point_unknowns(problem);
    const retrax_index place = i < n ? i : q - m + (i - n) % m;
    double found = retrax_collocates(problem) ? 0.0 : ARRAY(CURVATURES)[i];
    for (retrax_index point = 0; point < problem->steps * problem->points && retrax_collocates(problem); point++) {
        found = retrax_larger(found, fabs(ARRAY(POINT_HESSIANS)[(point * q + place) * q + place]));
    }
    for (int side = 0; side < 2 && i < n; side++) {
        const retrax_end_cost cost = retrax_end_cost_of(layout, trajectory, side == 1);
        found = retrax_larger(found, cost.derivative != NULL ? fabs(cost.curvature[i * n + i]) : 0.0);
    }
    return found;
}

/* What the Lagrangian of a step is made of: its cost, the parts of its derivative by unknowns that move by what they
 * span, and, where these vanish, its curvature. */
static double content_of(const retrax_phase *phase, const double *trajectory) {
    const retrax_layout *const layout = phase->layout;
    double found = 0.0;
    for (retrax_index k = 0; k < layout->problem->steps; k++) {
        found = retrax_larger(found, fabs(ARRAY(COSTS)[k]));
    }
    for (retrax_index i = 0; i < layout->count[RETRAX_ARRAY_PARTS]; i++) {
        const double span = retrax_span_of(layout, trajectory, i), unit = phase->judging.unknowns[i];
        const double size = i < layout->problem->state_size ? span : retrax_larger(span, unit); /* at rest controls are 0 */
        found = retrax_larger(found, span * ARRAY(PARTS)[i]);
        found = retrax_larger(found, size * size * own_curvature(layout, trajectory, i));
    }
    return found;
}

/* Whether a trajectory is judged by what it spans: else no scaling factor is what controls reach, or the cost sets the
 * scale, as the curvature has no bound. */
static bool is_judged_by_spans(const retrax_problem *problem) {
    return problem->control_size > 0 && !retrax_has_inequalities(problem);
}

void retrax_measure_by_spans(const retrax_search *search, double *iterate) {
    bool any = false;
    EACH_PHASE(phase) { any = any || is_judged_by_spans(phase->layout->problem); }
    if (!any) {
        return;
    }
    double content = retrax_is_coupled(search) ? retrax_largest_curvature(search, iterate) : 0.0;
    EACH_PHASE(phase) { content = retrax_larger(content, content_of(phase, iterate + phase->place)); }
    EACH_PHASE(phase) {
        const retrax_layout *const layout = phase->layout;
        double *const trajectory = iterate + phase->place, *const residuals = ARRAY(RESIDUALS);
        const bool judged = is_judged_by_spans(layout->problem);
        for (retrax_index i = 0; judged && i < layout->count[RETRAX_ARRAY_PARTS]; i++) {
            double span = retrax_span_of(layout, trajectory, i);
            if (i >= layout->problem->state_size) { /* a control that should not be zero may be: what costs as much counts */
                const double curvature = own_curvature(layout, trajectory, i);
                span = retrax_larger(span, curvature > 0.0 ? sqrt(content / curvature) : 0.0);
            }
            const double parts = retrax_larger(span * ARRAY(PARTS)[i], RETRAX_SHARE * content);
            const double share = span * ARRAY(LARGEST_SLOPES)[i] / retrax_or_one(parts);
            residuals[RETRAX_STATIONARITY] = retrax_larger(residuals[RETRAX_STATIONARITY], share);
        }
        residuals[RETRAX_KKT_ERROR] = retrax_larger(residuals[RETRAX_KKT_ERROR], residuals[RETRAX_STATIONARITY]);
    }
}

/* Adds the residuals of the inequalities. */
static void measure_inequalities(const retrax_layout *layout, double *trajectory, const retrax_limit_scale *limits,
                                 double *residuals) {
    const double *const survey = ARRAY(LIMIT_SURVEY), barrier = *ARRAY(BARRIER);
    const double off = retrax_larger(survey[RETRAX_LIMIT_PRODUCT] - barrier, barrier - survey[RETRAX_LIMIT_LEAST]);
    const double steps = (double)layout->problem->steps;
    residuals[RETRAX_VIOLATION] = survey[RETRAX_LIMIT_VIOLATION];
    residuals[RETRAX_EXCESS] = survey[RETRAX_LIMIT_EXCESS];
    residuals[RETRAX_COMPLEMENTARITY] = survey[RETRAX_LIMIT_PRODUCT] / limits->rate;
    residuals[RETRAX_CENTRING] = retrax_larger(0.0, off) / limits->rate;
    residuals[RETRAX_INFEASIBILITY] += survey[RETRAX_LIMIT_SUMMED_DEFECT] * steps / retrax_duration(layout, trajectory);
    residuals[RETRAX_BARRIER_OBJECTIVE] += survey[RETRAX_LIMIT_POTENTIAL];
    residuals[RETRAX_CONSTRAINT_TERM] += survey[RETRAX_LIMIT_CONSTRAINT_TERM];
}

void retrax_measure_residuals(const retrax_layout *layout, double *trajectory, const retrax_residual_scale *scale,
                              const retrax_limit_scale *limits) {
    const retrax_index n = layout->problem->state_size, E = layout->problem->state_numbers;
    const double *const points = ARRAY(POINT_SURVEY);
    double *const residuals = ARRAY(RESIDUALS), parts;
    fill(residuals, 0.0, RETRAX_RESIDUALS);
    write_measures(layout, trajectory, scale->judging_nodes);
    double defect = 0.0, stationarity = stationarity_of(layout, trajectory, scale, &parts);
    for (retrax_index e = 0; e < E; e++) {
        defect = retrax_larger(defect, ARRAY(DISTANCE)[e] / retrax_or_one(ARRAY(ENTRIES)[e]));
    }
    for (retrax_index a = 0; a < n; a++) {
        const double unit = scale->judging_nodes[a];
        const double most = retrax_larger(ARRAY(MAX_DEFECTS)[a], points[RETRAX_POINTS_OF_POINT * n + a]);
        const double size = retrax_or_one(retrax_larger(unit * points[RETRAX_POINTS_PARTS * n + a], RETRAX_SHARE * parts));
        defect = retrax_larger(defect, points[RETRAX_POINTS_OF_STEP * n + a] / retrax_or_one(ARRAY(ALONG)[a]));
        stationarity = retrax_larger(stationarity, unit * points[RETRAX_POINTS_SLOPE * n + a] / size);
        residuals[RETRAX_INFEASIBILITY] += (ARRAY(SUMMED_DEFECTS)[a] + points[RETRAX_POINTS_TOTAL * n + a]) / scale->nodes[a];
        residuals[RETRAX_MAX_SCALED_DEFECT] = retrax_larger(residuals[RETRAX_MAX_SCALED_DEFECT], most / scale->nodes[a]);
    }
    residuals[RETRAX_DEFECT] = defect;
    residuals[RETRAX_STATIONARITY] = stationarity;
    residuals[RETRAX_BARRIER_OBJECTIVE] = ARRAY(TOTALS)[0];
    residuals[RETRAX_CONSTRAINT_TERM] = ARRAY(TOTALS)[1];
    if (limits != NULL) {
        measure_inequalities(layout, trajectory, limits, residuals);
    }
    const double error = retrax_larger(retrax_larger(defect, stationarity), residuals[RETRAX_VIOLATION]);
    residuals[RETRAX_ERROR_WITHOUT_COMPLEMENTARITY] = error;
    residuals[RETRAX_KKT_ERROR] =
        retrax_larger(error, retrax_larger(residuals[RETRAX_EXCESS], residuals[RETRAX_COMPLEMENTARITY]));
    residuals[RETRAX_BARRIER_ERROR] = retrax_larger(error, residuals[RETRAX_CENTRING]);
    residuals[RETRAX_BARRIER_OBJECTIVE] /= scale->cost;
    residuals[RETRAX_CONSTRAINT_TERM] /= scale->cost;
}
