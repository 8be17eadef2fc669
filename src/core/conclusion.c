/*
 * Conclusion: whether what a search has found is an extremal, and whether the conditions of second order hold there.
 *
 * Where an inequality is active its stiffness D grows without bound as the barrier vanishes: H + w J' D J then has a
 * curvature beside it that is small relative to its entries, and lost in their rounding. So the inertia is that of a
 * system in which no stiffness is large: what is positive definite with less stiffness is so with more.
 */
#include "search.h"

#include <math.h>

/* In units of the cost and of the inequality: the first limit of the stiffness, the last one, and the factor from one to
 * the next. An inequality that curves much where it holds needs more, as the keep-out cone of the problem library 1e9;
 * more than enough drowns the curvature beside it in rounding, as 1e9 in a case of tests/integrators/test_flat_limits.py. */
#define LEAST_STIFF 1e4
#define MOST_STIFF 1e10
#define STIFFER 1e3
/* In the same units: one over the least stiffness that is not left out. */
#define IDLE 1e6

bool retrax_is_extremal(const retrax_search *search) {
    return search->converged && RESIDUAL(search->at, KKT_ERROR) <= search->options.tolerance;
}

/* Whether the Hessians by the controls of all points are positive definite, with the share of the inequalities. */
static bool legendre_holds(const retrax_phase *phase, const double *trajectory) {
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

/* Limits the stiffness of the inequalities of a trajectory, which was evaluated: by longer slacks, and none of one that
 * is next to not stiff. */
static void limit_stiffness(const retrax_phase *phase, double *trajectory, double stiffest) {
    const retrax_layout *const layout = phase->layout;
    for (retrax_index i = 0; i < layout->count[RETRAX_ARRAY_LIMITS]; i++) {
        const double constraint_scale = phase->constraint_scales[retrax_limit_of(layout->problem, i).limit];
        const double weight = ARRAY(LIMIT_WEIGHTS)[i], unit = phase->judging.cost / (constraint_scale * constraint_scale);
        if (weight * retrax_stiffness(layout, trajectory, i) > unit / IDLE) {
            ARRAY(SLACKS)[i] = fmax(ARRAY(SLACKS)[i], weight * ARRAY(LIMIT_MULTIPLIERS)[i] / (stiffest * unit));
        } else {
            ARRAY(LIMIT_MULTIPLIERS)[i] = 0.0;
        }
    }
}

/* Whether the Hessian of the Lagrangian with inequalities of limited stiffness is positive definite on the null space of
 * the equations, beyond rounding; the trial is overwritten. */
static bool is_strict_with(retrax_search *search, double stiffest) {
    const retrax_direction step = search->direction;
    retrax_copy_iterate(search, search->at, search->trial);
    retrax_swap(search);
    retrax_evaluate_functions(search, search->at);
    EACH_PHASE(phase) { limit_stiffness(phase, search->at + phase->place, stiffest); }
    retrax_assemble(search, search->at);
    retrax_eliminate(search, 0.0);
    const bool strict = search->direction.strict;
    retrax_swap(search);
    search->direction = step;
    return strict;
}

/* Whether the inequalities with some limit of their stiffness show a strict minimum: what is one with less stiffness is one
 * with more. */
static bool is_strict(retrax_search *search) {
    for (double stiffest = LEAST_STIFF; stiffest <= MOST_STIFF; stiffest *= STIFFER) {
        if (is_strict_with(search, stiffest)) {
            return true;
        }
    }
    return false;
}

/* Whether the linear system of the iterate has the inertia of a minimum without a regularisation. */
static bool is_inertia_correct(retrax_search *search) {
    const retrax_direction step = search->direction;
    retrax_newton_step(search, 0.0);
    const bool found = search->direction.inertia_correct;
    search->direction = step;
    return found;
}

void retrax_conclude(retrax_search *search) {
    const retrax_direction *const step = &search->direction;
    const bool extremal = retrax_is_extremal(search);
    search->legendre_holds = extremal;
    EACH_PHASE(phase) { search->legendre_holds = search->legendre_holds && legendre_holds(phase, search->at + phase->place); }
    search->inertia_correct = !extremal && search->trials > search->options.max_iterations && is_inertia_correct(search);
    search->strict = extremal && search->isolated &&
                     (search->has_inequalities ? is_strict(search) : step->strict && step->regularisation == 0.0);
}
