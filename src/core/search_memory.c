/*
 * The memory of a search.
 */
#include "search.h"
#include "workspace.h"

/* Bound of the iterations of a search, whose costs are kept. */
#define MOST_ITERATIONS ((retrax_index)1 << 20)

/* Takes the arrays of a phase from a block. */
static void take_phase(const retrax_layout *layout, bool coupled, retrax_block *block, retrax_phase *to) {
    const retrax_problem *const problem = layout->problem;
    const retrax_index n = problem->state_size, E = problem->state_numbers, m = problem->control_size;
    const retrax_index c = problem->inequalities + problem->node_inequalities, z = layout->count[RETRAX_ARRAY_PARTS];
    const retrax_index points = problem->steps * problem->points;
    retrax_scale *const scales[] = {&to->judging, &to->steps, &to->fresh};
    for (int i = 0; i < 3; i++) {
        scales[i]->unknowns = retrax_take(block, z, 1, sizeof(double));
        scales[i]->nodes = retrax_take(block, n, 1, sizeof(double));
    }
    to->constraint_scales = retrax_take(block, c, 1, sizeof(double));
    to->curvatures = retrax_take(block, z, 1, sizeof(double));
    to->largest = retrax_take(block, z, 1, sizeof(double));
    to->sizes = retrax_take(block, z, 1, sizeof(double));
    to->values = retrax_take(block, z, 1, sizeof(double));
    to->room = retrax_take(block, z, 1, sizeof(double));
    to->work = retrax_take(block, 2, E, sizeof(double));
    to->ways = retrax_take(block, 2 * points, m, sizeof(double));
    to->control_work = retrax_take(block, points + 1, m, sizeof(double));
    to->limit_curvatures = retrax_take(block, retrax_curved_limits(problem) * points, m, sizeof(double));
    to->square = retrax_take(block, z, z, sizeof(double));
    to->constant_norm = retrax_take(block, E + problem->control_numbers, 1, sizeof(bool));
    if (coupled) {
        retrax_take_response(layout, block, &to->response);
    }
}

/* Bytes of workspace that a phase needs; 0 if that does not fit. */
static size_t workspace_of(const retrax_layout *layout, bool coupled) {
    const retrax_problem *const problem = layout->problem;
    const size_t own = retrax_workspace(problem);
    const retrax_index n = problem->state_size, z = layout->count[RETRAX_ARRAY_PARTS];
    const size_t more = retrax_block_workspace(problem->steps, n, z, coupled ? 1 + 2 * n : 1);
    return own == 0 || more == 0 ? 0 : (own > more ? own : more);
}

/* Writes which phases a search has; returns the numbers of their trajectories. */
static retrax_index place_phases(const retrax_multiphase *problem, retrax_phase *phases) {
    retrax_index numbers = 0;
    for (retrax_index k = 0; k < problem->phases; k++) {
        if (phases != NULL) {
            phases[k].layout = problem->layouts[k];
            phases[k].place = numbers;
        }
        numbers += problem->layouts[k]->numbers;
    }
    return numbers;
}

/* Writes where the guess of each phase stands; returns the numbers of all of them. */
static retrax_index place_guess(const retrax_multiphase *problem, retrax_phase *phases) {
    retrax_index numbers = 0;
    for (retrax_index k = 0; k < problem->phases; k++) {
        if (phases != NULL) {
            phases[k].guess_place = numbers;
        }
        numbers += problem->layouts[k]->first[RETRAX_ARRAY_POINT_CENTRES];
    }
    return numbers;
}

/* Lays out a search in a block. */
static retrax_search *lay_out(const retrax_multiphase *problem, retrax_index max_iterations, retrax_block *block) {
    const bool coupled = problem->function.evaluate != NULL;
    retrax_search *const own = retrax_take(block, 1, 1, sizeof(retrax_search));
    retrax_search unused, *const to = own == NULL ? &unused : own;
    to->phases = retrax_take(block, problem->phases, 1, sizeof(retrax_phase));
    to->numbers = place_phases(problem, to->phases);
    if (coupled) {
        to->numbers = retrax_place_coupling(problem, to->numbers, &to->coupling);
        retrax_take_coupling(block, &to->coupling);
    }
    to->at = retrax_take(block, to->numbers, 1, sizeof(double));
    to->trial = retrax_take(block, to->numbers, 1, sizeof(double));
    to->guess_multipliers = place_guess(problem, to->phases);
    const retrax_index multipliers = coupled ? to->coupling.count[RETRAX_COUPLED_MULTIPLIERS] : 0;
    to->first = retrax_take(block, to->guess_multipliers + multipliers, 1, sizeof(double));
    to->costs = retrax_take(block, max_iterations + 3, 1, sizeof(double));
    size_t workspace = 0;
    for (retrax_index k = 0; k < problem->phases; k++) {
        retrax_phase phase;
        const size_t needed = workspace_of(problem->layouts[k], coupled);
        take_phase(problem->layouts[k], coupled, block, own == NULL ? &phase : &to->phases[k]);
        workspace = workspace > needed ? workspace : needed;
    }
    to->workspace = retrax_take(block, 1, 1, workspace > 0 ? workspace : 1);
    return own;
}

size_t retrax_search_memory(const retrax_multiphase *problem, retrax_index max_iterations) {
    const bool coupled = problem->function.evaluate != NULL;
    retrax_block block = {NULL, 0};
    if (problem->phases < 1 || (problem->phases > 1 && !coupled) || max_iterations < 1 ||
        max_iterations > MOST_ITERATIONS) {
        return 0;
    }
    for (retrax_index k = 0; k < problem->phases; k++) {
        if (workspace_of(problem->layouts[k], coupled) == 0) {
            return 0;
        }
    }
    lay_out(problem, max_iterations, &block);
    return block.used == SIZE_MAX ? 0 : block.used;
}

retrax_search *retrax_search_make(const retrax_multiphase *problem, const retrax_options *options,
                                  retrax_instruction_set set, void *memory) {
    retrax_block block = {memory, 0};
    retrax_search *const search = lay_out(problem, options->max_iterations, &block);
    search->problem = problem;
    search->options = *options;
    search->set = set;
    search->penalty_scale = options->penalty_scale;
    search->has_inequalities = false;
    EACH_PHASE(phase) {
        search->has_inequalities = search->has_inequalities || retrax_has_inequalities(phase->layout->problem);
        phase->limits = (retrax_limit_scale){0.0, phase->constraint_scales};
    }
    const bool coupled = retrax_is_coupled(search);
    const retrax_index *const first = search->phases->layout->first;
    search->residuals = coupled ? search->coupling.first[RETRAX_COUPLED_RESIDUALS] : first[RETRAX_ARRAY_RESIDUALS];
    search->totals = coupled ? search->coupling.first[RETRAX_COUPLED_TOTALS] : first[RETRAX_ARRAY_TOTALS];
    return search;
}

double *retrax_search_trajectory(retrax_search *search, retrax_index phase) {
    return search->at + search->phases[phase].place;
}

double *retrax_search_multipliers(retrax_search *search, bool first) {
    return first ? search->first + search->guess_multipliers
                 : search->at + search->coupling.first[RETRAX_COUPLED_MULTIPLIERS];
}

retrax_search_result retrax_search_read(const retrax_search *search, retrax_index phase) {
    const retrax_direction *const step = &search->direction;
    const retrax_phase *const own = &search->phases[phase];
    const bool extremal = retrax_is_extremal(search), coupled = retrax_is_coupled(search);
    const retrax_index *const first = search->coupling.first;
    return (retrax_search_result){
        .trajectory = search->at + own->place,
        .first = search->first + own->guess_place,
        .judging = own->judging,
        .steps = own->steps,
        .limits = own->constraint_scales,
        .rate = own->limits.rate,
        .residuals = search->at + search->residuals,
        .equations = coupled ? search->coupling.sizes : NULL,
        .values = coupled ? search->at + first[RETRAX_COUPLED_VALUES] : NULL,
        .jacobian = coupled ? search->at + first[RETRAX_COUPLED_JACOBIAN] : NULL,
        .iterations = search->trials - 1,
        .iteration_limit_reached = search->trials > search->options.max_iterations,
        .converged = extremal,
        .strict = search->strict,
        .legendre_holds = search->legendre_holds,
        .solvable = step->finite && step->regularisation < RETRAX_LARGEST_REGULARISATION,
        .infeasible = retrax_is_infeasible(search),
        .diverging = !extremal && retrax_cost_diverges(search),
        .stopped = search->stopped,
        .inertia_correct = search->inertia_correct,
    };
}
