/*
 * Inequalities at the points of the steps: slacks, excesses and multipliers, which are eliminated point by point.
 */
#include "layout.h"

#include <math.h>

/* Factor of mu / s within which multipliers stay. */
#define KAPPA_SIGMA 1e10
/* Share of its penalty at which a multiplier says that the penalty is too small. */
#define NEAR_PENALTY 0.5
/* The largest penalty, relative to the unit of the multipliers. */
#define LAST_PENALTY 1e6

/* The inequalities of a trajectory: those of all points, then those of the ends of all steps. */
typedef struct {
    retrax_index count;     /* of all */
    retrax_index of_points; /* of them, `each` at a point */
    retrax_index each, at_ends;
    const double *values, *weights, *penalties;
    double *slacks, *multipliers, *excesses;
    double barrier;
} inequalities;

static inequalities inequalities_of(const retrax_layout *layout, double *trajectory) {
    return (inequalities){
        .count = layout->count[RETRAX_ARRAY_LIMITS],
        .of_points = layout->problem->steps * layout->problem->points * layout->problem->inequalities,
        .each = layout->problem->inequalities,
        .at_ends = layout->problem->node_inequalities,
        .values = ARRAY(LIMITS),
        .weights = ARRAY(LIMIT_WEIGHTS),
        .penalties = ARRAY(PENALTIES),
        .slacks = ARRAY(SLACKS),
        .multipliers = ARRAY(LIMIT_MULTIPLIERS),
        .excesses = ARRAY(EXCESSES),
        .barrier = *ARRAY(BARRIER),
    };
}

static bool is_elastic(const inequalities *own, retrax_index i) { return own->penalties[i] < INFINITY; }

/* zeta = rho - nu */
static double rest(const inequalities *own, retrax_index i) { return own->penalties[i] - own->multipliers[i]; }

double retrax_stiffness(const retrax_layout *layout, const double *trajectory, retrax_index i) {
    const double nu = ARRAY(LIMIT_MULTIPLIERS)[i], penalty = ARRAY(PENALTIES)[i];
    return nu / (ARRAY(SLACKS)[i] + (penalty < INFINITY ? nu * ARRAY(EXCESSES)[i] / (penalty - nu) : 0.0));
}

/* 1 / nu - 1 / zeta */
static double barrier_slope(const inequalities *own, retrax_index i) {
    return own->multipliers[i] > 0.0 ? 1.0 / own->multipliers[i] - 1.0 / rest(own, i) : 0.0;
}

/* What g + s - t lacks of zero. */
static double limit_defect(const inequalities *own, retrax_index i) {
    return own->values[i] + own->slacks[i] - own->excesses[i];
}

/* Writes slopes without a share of inequalities, and zeros as those that the barrier multiplies. */
static void begin_slopes(double *slopes, double *driven, const double *plain, retrax_index count) {
    retrax_copy(slopes, plain, count);
    memset(driven, 0, sizeof(double) * (size_t)count);
}

void retrax_add_inequalities(const retrax_layout *layout, double *trajectory) {
    const inequalities own = inequalities_of(layout, trajectory);
    const bool collocates = retrax_collocates(layout->problem);
    double *const slopes[] = {collocates ? ARRAY(RIGHT_SLOPES) : ARRAY(RIGHT_SIDES), ARRAY(RIGHT_END_SLOPES)};
    double *const driven[] = {collocates ? ARRAY(BARRIER_SLOPES) : ARRAY(BARRIER_SIDES), ARRAY(BARRIER_END_SLOPES)};
    double *const hessians[] = {collocates ? ARRAY(POINT_HESSIANS) : ARRAY(HESSIANS), ARRAY(END_HESSIANS)};
    begin_slopes(slopes[0], driven[0], collocates ? ARRAY(POINT_SLOPES) : ARRAY(SLOPES),
                 layout->count[collocates ? RETRAX_ARRAY_POINT_SLOPES : RETRAX_ARRAY_SLOPES]);
    begin_slopes(slopes[1], driven[1], ARRAY(END_SLOPES), layout->count[RETRAX_ARRAY_RIGHT_END_SLOPES]);
    for (retrax_index i = 0; i < own.count; i++) {
        if (own.weights[i] == 0.0) {
            continue;
        }
        const retrax_limit of = retrax_limit_of(layout->problem, i);
        const retrax_index width = of.width;
        const double *const row = ARRAY(LIMIT_JACOBIANS) + of.first;
        const double stiff = own.weights[i] * retrax_stiffness(layout, trajectory, i);
        const double first = stiff * own.values[i], second = stiff * barrier_slope(&own, i);
        double *const hessian = hessians[of.at_ends] + of.block * width * width;
        for (retrax_index a = 0; a < width; a++) {
            if (row[a] == 0.0) {
                continue;
            }
            slopes[of.at_ends][of.block * width + a] += row[a] * first;
            driven[of.at_ends][of.block * width + a] += row[a] * second;
            for (retrax_index b = 0; b < width; b++) {
                hessian[a * width + b] += row[a] * stiff * row[b];
            }
        }
    }
}

/* One of the inequalities along the trajectory: the places first, first + stride, ... before last. */
typedef struct {
    retrax_index first, stride, last;
} limit_row;

static limit_row row_of(const inequalities *own, retrax_index limit) {
    if (limit < own->each) {
        return (limit_row){limit, own->each, own->of_points};
    }
    return (limit_row){own->of_points + limit - own->each, own->at_ends, own->count};
}

/* The size that an inequality is measured by. */
static double size_of(const inequalities *own, limit_row row, double constraint_scale) {
    double found = constraint_scale;
    for (retrax_index i = row.first; i < row.last; i += row.stride) {
        if (own->weights[i] > 0.0) {
            found = retrax_larger(found, RETRAX_VALUE_SHARE * fabs(own->values[i]));
        }
    }
    return found;
}

/* Adds an elastic inequality to the survey. */
static void survey_excess(const inequalities *own, retrax_index i, double constraint_scale, const retrax_limit_scale *scale,
                          double *survey) {
    const double unit = scale->rate / constraint_scale, penalty = own->penalties[i];
    survey[RETRAX_LIMIT_PENALTY_GROWTH] =
        retrax_larger(survey[RETRAX_LIMIT_PENALTY_GROWTH], penalty / (RETRAX_FIRST_PENALTY * unit));
    if (own->multipliers[i] <= NEAR_PENALTY * penalty) {
        return;
    }
    if (penalty < LAST_PENALTY * unit) {
        survey[RETRAX_LIMIT_PENALTY_TOO_SMALL] = 1.0;
    } else {
        survey[RETRAX_LIMIT_LEFT] = retrax_larger(survey[RETRAX_LIMIT_LEFT], own->excesses[i] / constraint_scale);
    }
}

void retrax_survey_inequalities(const retrax_layout *layout, double *trajectory, const retrax_limit_scale *scale) {
    const inequalities own = inequalities_of(layout, trajectory);
    double *const survey = ARRAY(LIMIT_SURVEY);
    for (retrax_index k = 0; k < layout->count[RETRAX_ARRAY_LIMIT_SURVEY]; k++) {
        survey[k] = k == RETRAX_LIMIT_LEAST ? INFINITY : 0.0;
    }
    for (retrax_index j = 0; j < own.each + own.at_ends; j++) {
        const limit_row row = row_of(&own, j);
        const double constraint_scale = scale->limits[j], size = size_of(&own, row, constraint_scale);
        for (retrax_index i = row.first; i < row.last; i += row.stride) {
            const double w = own.weights[i], defect = limit_defect(&own, i), product = own.slacks[i] * own.multipliers[i];
            if (!(w > 0.0)) {
                continue;
            }
            double cost = -own.barrier * log(own.slacks[i] / constraint_scale);
            survey[RETRAX_LIMIT_VIOLATION] = retrax_larger(survey[RETRAX_LIMIT_VIOLATION], fabs(defect) / size);
            survey[RETRAX_LIMIT_EXCESS] = retrax_larger(survey[RETRAX_LIMIT_EXCESS], own.excesses[i] / size);
            survey[RETRAX_LIMIT_PRODUCT] = retrax_larger(survey[RETRAX_LIMIT_PRODUCT], product);
            survey[RETRAX_LIMIT_LEAST] = -retrax_larger(-survey[RETRAX_LIMIT_LEAST], -product);
            if (is_elastic(&own, i)) {
                const double other = own.excesses[i] * rest(&own, i);
                survey[RETRAX_LIMIT_PRODUCT] = retrax_larger(survey[RETRAX_LIMIT_PRODUCT], other);
                survey[RETRAX_LIMIT_LEAST] = -retrax_larger(-survey[RETRAX_LIMIT_LEAST], -other);
                cost += own.penalties[i] * own.excesses[i] - own.barrier * log(own.excesses[i] / constraint_scale);
                survey_excess(&own, i, constraint_scale, scale, survey);
            }
            survey[RETRAX_LIMIT_SUMMED_DEFECT] += w * fabs(defect) / constraint_scale;
            survey[RETRAX_LIMIT_POTENTIAL] += w * cost;
            survey[RETRAX_LIMIT_CONSTRAINT_TERM] += w * own.multipliers[i] * defect;
        }
    }
}

/* The fraction of a step that leaves its share of a value, if that is less than the fraction so far. */
static double shortened(double fraction, double value, double step, double share) {
    return step < 0.0 ? fmin(fraction, -share * value / step) : fraction;
}

/* Writes the steps (dx, dxi, dnu, du) of the points of collocation steps, and (dx, deta) of their ends. */
static void write_point_steps(const retrax_layout *layout, double *trajectory) {
    const retrax_problem *const problem = layout->problem;
    const retrax_index s = problem->points, n = problem->state_size, q = retrax_point_unknowns(problem);
    const retrax_collocation_system system = {.points = s,
                                              .state_size = n,
                                              .control_size = problem->control_size,
                                              .columns = 1,
                                              .step_size = ARRAY(STEP_SIZE),
                                              .matrix = problem->matrix,
                                              .weights = problem->weights};
    const retrax_index first = problem->node_inequalities > 0 ? RETRAX_AT_ENDS : 0;
    for (retrax_index k = 0; k < problem->steps; k++) {
        const double *const step = ARRAY(STEPS) + k * layout->count[RETRAX_ARRAY_PARTS];
        for (retrax_index i = first; i < s; i++) {
            double *const to = i < 0 ? ARRAY(END_STEPS) + k * 2 * n : ARRAY(POINT_STEPS) + (k * s + i) * q;
            retrax_write_place(&system, k, i, 0, step, ARRAY(VELOCITY_STEPS) + k * s * n, to);
        }
    }
}

void retrax_step_inequalities(const retrax_layout *layout, double *trajectory, double share) {
    const inequalities own = inequalities_of(layout, trajectory);
    double primal = 1.0, dual = 1.0, ahead = 0.0, constraint_term = 0.0;
    const double *const steps[] = {retrax_collocates(layout->problem) ? ARRAY(POINT_STEPS) : ARRAY(STEPS),
                                   ARRAY(END_STEPS)};
    if (retrax_collocates(layout->problem)) {
        write_point_steps(layout, trajectory);
    }
    for (retrax_index i = 0; i < own.count; i++) {
        const double w = own.weights[i], nu = own.multipliers[i], s = own.slacks[i], t = own.excesses[i];
        double ds = 0.0, dnu = 0.0, dt = 0.0;
        if (w > 0.0) {
            const retrax_limit of = retrax_limit_of(layout->problem, i);
            const double *const row = ARRAY(LIMIT_JACOBIANS) + of.first;
            const double *const step = steps[of.at_ends] + of.block * of.width;
            double value = own.values[i];
            for (retrax_index a = 0; a < of.width; a++) {
                value += row[a] * step[a];
            }
            dnu = retrax_stiffness(layout, trajectory, i) * (value + own.barrier * barrier_slope(&own, i));
            ds = (own.barrier - s * dnu) / nu - s;
            double slope = -own.barrier * ds / s;
            if (is_elastic(&own, i)) {
                dt = (own.barrier + t * dnu) / rest(&own, i) - t;
                slope += (own.penalties[i] - own.barrier / t) * dt;
                primal = shortened(primal, t, dt, share);
                dual = shortened(dual, rest(&own, i), -dnu, share);
            }
            primal = shortened(primal, s, ds, share);
            dual = shortened(dual, nu, dnu, share);
            ahead += w * slope;
            constraint_term += w * dnu * limit_defect(&own, i);
        }
        ARRAY(SLACK_STEPS)[i] = ds;
        ARRAY(LIMIT_MULTIPLIER_STEPS)[i] = dnu;
        ARRAY(EXCESS_STEPS)[i] = dt;
    }
    double *const lengths = ARRAY(LIMIT_STEP);
    lengths[RETRAX_STEP_PRIMAL] = primal;
    lengths[RETRAX_STEP_DUAL] = dual;
    lengths[RETRAX_STEP_AHEAD] = ahead;
    lengths[RETRAX_STEP_CONSTRAINT_TERM] = constraint_term;
}

void retrax_move_inequalities(const retrax_layout *layout, const double *from, double primal, double dual,
                              double *trajectory) {
    const inequalities own = inequalities_of(layout, trajectory);
    for (retrax_index i = 0; i < own.count; i++) {
        own.slacks[i] = from[layout->first[RETRAX_ARRAY_SLACKS] + i] + primal * from[layout->first[RETRAX_ARRAY_SLACK_STEPS] + i];
        own.excesses[i] =
            from[layout->first[RETRAX_ARRAY_EXCESSES] + i] + primal * from[layout->first[RETRAX_ARRAY_EXCESS_STEPS] + i];
        double nu = from[layout->first[RETRAX_ARRAY_LIMIT_MULTIPLIERS] + i] +
                    dual * from[layout->first[RETRAX_ARRAY_LIMIT_MULTIPLIER_STEPS] + i];
        if (!is_elastic(&own, i)) {
            const double centre = own.barrier / own.slacks[i];
            nu = nu > 0.0 ? fmin(fmax(nu, centre / KAPPA_SIGMA), KAPPA_SIGMA * centre) : 0.0;
        }
        own.multipliers[i] = nu;
    }
}
