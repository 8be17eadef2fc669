/*
 * Inertia: the Newton step, and the regularisation of the Hessian with which it descends.
 *
 * Where the Hessian is not positive definite on the null space of the constraints, its diagonal is raised until the
 * inertia says that it is: else the way to a minimum leads past saddles. Where constraints depend on each other no
 * inertia is right. From a large regularisation on positive curvature along the step is enough [Chiang, Zavala, An
 * inertia-free filter line-search algorithm, Comput. Optim. Appl. 64, 2016]; so it is where the steps of a trajectory are
 * farther apart than it is long, since the multipliers of such equations, and the curvature that these weigh, tell
 * nothing of a minimum.
 */
#include "search.h"

#include <math.h>

/* Relative curvature along a step, of which less does not descend. */
#define CURVATURE 1e-9
/* A regularisation that makes the Hessian convex on the null space of the constraints, if these are independent. */
#define SUFFICIENT 1e2
/* Times the spread of a trajectory: gaps from which on its pieces do not belong together. */
#define APART 1.0
/* Share of the largest curvature of a coordinate in units of the scaling that others are regularised by at least. */
#define SOFTEST 1e-3
/* Share of the way to the boundary that slacks and multipliers may go. */
#define BOUNDARY 0.99
/* A smallest pivot below this is rounding, eps^0.6; with more than so many equations, rounding hides more. */
#define CLEAR 4.05381695970951e-10
#define MANY 1e3

/* Writes the typical curvatures of the coordinates in units of the scaling. With a barrier the curvature has no bound,
 * and coupled trajectories have one measure. */
static void write_curvatures(const retrax_search *search, retrax_phase *phase) {
    const retrax_layout *const layout = phase->layout;
    const double *const trajectory = search->at + phase->place, *const sizes = phase->steps.unknowns;
    const retrax_index z = layout->count[RETRAX_ARRAY_PARTS];
    const bool same = retrax_has_inequalities(layout->problem) || retrax_is_coupled(search);
    double most = 0.0;
    for (retrax_index i = 0; i < z; i++) {
        phase->curvatures[i] = same ? 1.0 : ARRAY(CURVATURES)[i] * sizes[i] * sizes[i] / phase->steps.cost;
        most = fmax(most, phase->curvatures[i]);
    }
    for (retrax_index i = 0; i < z; i++) {
        phase->curvatures[i] = SOFTEST * most > 0.0 ? fmax(phase->curvatures[i], SOFTEST * most) : 1.0;
    }
}

static double product(const double *a, const double *b, retrax_index count) {
    double sum = 0.0;
    for (retrax_index i = 0; i < count; i++) {
        sum += a[i] * b[i];
    }
    return sum;
}

/* Adds the first-order changes of the cost, and of the multipliers times what is lacking, by all that may be made. */
static void add_predicted_change(retrax_search *search, const retrax_phase *phase) {
    const retrax_layout *const layout = phase->layout;
    const double *const trajectory = search->at + phase->place;
    const retrax_index *const count = layout->count, z = count[RETRAX_ARRAY_PARTS];
    retrax_direction *const step = &search->direction;
    double ahead = product(ARRAY(GRADIENTS), ARRAY(STEPS), count[RETRAX_ARRAY_STEPS]), dual = 0.0;
    double term = product(ARRAY(MULTIPLIER_STEPS), ARRAY(DEFECTS), count[RETRAX_ARRAY_DEFECTS]);
    term += product(ARRAY(POINT_MULTIPLIER_STEPS), ARRAY(POINT_DEFECTS), count[RETRAX_ARRAY_POINT_DEFECTS]);
    const retrax_index p = layout->problem->points * layout->problem->state_size;
    for (retrax_index i = 0; i < count[RETRAX_ARRAY_VELOCITY_STEPS]; i++) { /* what mends the defects of the points */
        const double within = product(ARRAY(VELOCITY_MAPS) + i * (z + 1), ARRAY(STEPS) + i / p * z, z);
        ahead += ARRAY(GRADIENTS_BY_VELOCITIES)[i] * (ARRAY(VELOCITY_STEPS)[i] - within);
    }
    for (int i = 0; i < 2; i++) {
        const retrax_end_cost cost = retrax_end_cost_of(layout, trajectory, i == 1);
        if (cost.derivative != NULL && cost.mended != NULL) {
            ahead += product(cost.slope, cost.mended, layout->problem->state_size);
        }
    }
    if (retrax_has_inequalities(layout->problem)) {
        ahead += ARRAY(LIMIT_STEP)[RETRAX_STEP_AHEAD];
        dual = phase->dual * ARRAY(LIMIT_STEP)[RETRAX_STEP_CONSTRAINT_TERM];
    }
    step->predicted_change += step->alpha_max * ahead / phase->steps.cost;
    step->constraint_change += (step->alpha_max * term + dual) / phase->steps.cost;
}

bool retrax_is_clear(double smallest, retrax_index equations) {
    return smallest > CLEAR * fmax(1.0, (double)equations / MANY);
}

retrax_block_system retrax_newton_system(const retrax_search *search, const retrax_phase *phase, double regularisation) {
    const retrax_layout *const layout = phase->layout;
    const double *const trajectory = search->at + phase->place;
    const retrax_index N = layout->problem->steps, n = layout->problem->state_size;
    return (retrax_block_system){
        .stages = N,
        .node_size = n,
        .stage_size = layout->count[RETRAX_ARRAY_PARTS],
        .columns = 1,
        .hessian = ARRAY(HESSIANS),
        .left = ARRAY(LEFT),
        .right = ARRAY(RIGHT),
        .slope = ARRAY(NEWTON_SIDES),
        .defect = ARRAY(NEWTON_DEFECTS),
        .fixed_start = ARRAY(FIXED),
        .fixed_end = ARRAY(FIXED) + N * n,
        .stage_scale = phase->steps.unknowns,
        .node_scale = phase->steps.nodes,
        .cost_scale = phase->steps.cost,
        .regularisation = regularisation,
        .regularised = phase->curvatures,
    };
}

/* Solves the linear system of an iterate of one trajectory. */
static void eliminate_one(retrax_search *search, double regularisation) {
    const retrax_phase *const phase = search->phases;
    const retrax_layout *const layout = phase->layout;
    double *const trajectory = search->at;
    const retrax_index equations = layout->count[RETRAX_ARRAY_DEFECTS];
    const retrax_block_system system = retrax_newton_system(search, phase, regularisation);
    unsigned char finite;
    retrax_block_solution solution = {.step = ARRAY(STEPS),
                                      .multipliers = ARRAY(MULTIPLIER_STEPS),
                                      .finite = &finite,
                                      .largest_step = phase->largest};
    retrax_block_eliminate(&system, &solution, search->workspace, search->set);
    const bool right = solution.inertia.negative == equations;
    const bool clear = retrax_is_clear(solution.inertia.smallest, equations);
    const bool hidden = solution.inertia.smallest <= CLEAR * fmax(1.0, (double)equations / MANY);
    retrax_direction *const step = &search->direction;
    step->regularisation = regularisation;
    step->curvature = solution.curvature;
    step->size = solution.size;
    step->finite = finite != 0;
    step->strict = right && clear;
    step->inertia_correct = right || (!retrax_has_inequalities(layout->problem) && hidden);
}

/* Computes what belongs to the Newton step of a trajectory; returns the fraction of it that may be made. */
static double complete_step(const retrax_search *search, retrax_phase *phase) {
    double *const trajectory = search->at + phase->place;
    const retrax_layout *const layout = phase->layout;
    retrax_expand_step(layout, trajectory, search->workspace);
    phase->dual = 1.0;
    phase->step_cap = retrax_step_cap(layout, trajectory, phase->largest, search->trial + phase->place, phase->constant_norm);
    if (!retrax_has_inequalities(layout->problem)) {
        return phase->step_cap;
    }
    retrax_step_inequalities(layout, trajectory, BOUNDARY);
    phase->dual = ARRAY(LIMIT_STEP)[RETRAX_STEP_DUAL];
    return fmin(phase->step_cap, ARRAY(LIMIT_STEP)[RETRAX_STEP_PRIMAL]);
}

void retrax_eliminate(retrax_search *search, double regularisation) {
    EACH_PHASE(phase) { write_curvatures(search, phase); }
    (retrax_is_coupled(search) ? retrax_eliminate_coupled : eliminate_one)(search, regularisation);
}

void retrax_newton_step(retrax_search *search, double regularisation) {
    retrax_direction *const step = &search->direction;
    retrax_eliminate(search, regularisation);
    step->step_cap = step->alpha_max = 1.0;
    EACH_PHASE(phase) {
        step->alpha_max = fmin(step->alpha_max, complete_step(search, phase));
        step->step_cap = fmin(step->step_cap, phase->step_cap);
    }
    step->predicted_change = step->constraint_change = 0.0;
    EACH_PHASE(phase) { add_predicted_change(search, phase); }
    if (retrax_is_coupled(search)) {
        retrax_add_coupled_change(search);
    }
}

double retrax_step_length(const retrax_search *search) {
    double found = 0.0;
    EACH_PHASE(phase) {
        for (retrax_index i = 0; i < phase->layout->count[RETRAX_ARRAY_PARTS]; i++) {
            const double length = phase->largest[i] / phase->steps.unknowns[i];
            found = length > found || isnan(length) ? length : found;
        }
    }
    return found;
}

/* Whether the step has positive curvature, and the inertia of a convex problem, or a regularisation that is large. */
static bool descends(const retrax_search *search, bool curvature_test_only) {
    const retrax_direction *const step = &search->direction;
    const bool enough = curvature_test_only || step->regularisation >= SUFFICIENT || RESIDUAL(search->at, DEFECT) > APART;
    return step->curvature >= CURVATURE * step->size && (step->inertia_correct || enough);
}

void retrax_regularised_step(retrax_search *search, double regularisation, bool accept_any_inertia, bool curvature_test_only) {
    retrax_direction *const step = &search->direction;
    retrax_newton_step(search, regularisation);
    step->descends = descends(search, curvature_test_only);
    while (!(step->descends || accept_any_inertia) && step->regularisation < RETRAX_LARGEST_REGULARISATION) {
        retrax_newton_step(search, fmax(RETRAX_REGULARISATION_FACTOR * step->regularisation, RETRAX_FIRST_REGULARISATION));
        step->descends = descends(search, curvature_test_only);
    }
}
