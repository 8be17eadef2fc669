/*
 * The memory of a search.
 */
#include "search.h"
#include "workspace.h"

/* Bound of the iterations of a search, whose costs are kept. */
#define MOST_ITERATIONS ((retrax_index)1 << 20)

/* Takes the arrays of the linear system with the multipliers of the inequalities from a block. */
static void take_augmented(const retrax_problem *problem, retrax_block *block, retrax_augmented *to) {
    const retrax_index N = problem->steps, s = problem->points, n = problem->state_size, z = n + s * problem->control_size;
    const retrax_index limits = s * problem->inequalities + problem->node_inequalities, y = z + limits;
    to->size = y;
    if (limits == 0) {
        return;
    }
    to->rows = retrax_take(block, N * limits, z, sizeof(double));
    to->gives = retrax_take(block, N, limits, sizeof(double));
    to->sizes = retrax_take(block, y, 1, sizeof(double));
    to->hessian = retrax_take(block, N * y, y, sizeof(double));
    to->left = retrax_take(block, N * n, y, sizeof(double));
    to->right = retrax_take(block, N * n, y, sizeof(double));
    to->zeros = retrax_take(block, N + 1, y + n, sizeof(double));
    to->step = retrax_take(block, N, y, sizeof(double));
    to->multipliers = retrax_take(block, N + 1, n, sizeof(double));
    to->largest = retrax_take(block, y, 1, sizeof(double));
    const size_t size = retrax_block_workspace(N, n, y, 1);
    to->workspace = retrax_take(block, 1, 1, size == 0 ? SIZE_MAX / 2 : size);
}

/* Lays out a search in a block. */
static retrax_search *lay_out(const retrax_layout *layout, retrax_index max_iterations, retrax_block *block) {
    const retrax_problem *const problem = layout->problem;
    const retrax_index n = problem->state_size, E = problem->state_numbers, c = problem->inequalities + problem->node_inequalities;
    const retrax_index z = layout->count[RETRAX_ARRAY_PARTS], m = problem->control_size;
    const retrax_index points = problem->steps * problem->points;
    retrax_search *const own = retrax_take(block, 1, 1, sizeof(retrax_search));
    retrax_search unused, *const to = own == NULL ? &unused : own;
    to->at = retrax_take(block, layout->numbers, 1, sizeof(double));
    to->trial = retrax_take(block, layout->numbers, 1, sizeof(double));
    to->first = retrax_take(block, layout->numbers, 1, sizeof(double));
    to->spare = retrax_take(block, layout->numbers, 1, sizeof(double));
    to->judging.unknowns = retrax_take(block, z, 1, sizeof(double));
    to->judging.nodes = retrax_take(block, n, 1, sizeof(double));
    to->steps.unknowns = retrax_take(block, z, 1, sizeof(double));
    to->steps.nodes = retrax_take(block, n, 1, sizeof(double));
    to->fresh.unknowns = retrax_take(block, z, 1, sizeof(double));
    to->fresh.nodes = retrax_take(block, n, 1, sizeof(double));
    to->costs = retrax_take(block, max_iterations + RETRAX_SETTLING + 3, 1, sizeof(double));
    to->limit_sizes = retrax_take(block, c, 1, sizeof(double));
    to->curvatures = retrax_take(block, z, 1, sizeof(double));
    to->largest = retrax_take(block, z, 1, sizeof(double));
    to->sizes = retrax_take(block, z, 1, sizeof(double));
    to->values = retrax_take(block, z, 1, sizeof(double));
    to->room = retrax_take(block, z, 1, sizeof(double));
    to->work = retrax_take(block, 2, E, sizeof(double));
    to->ways = retrax_take(block, 2 * points, m, sizeof(double));
    to->control_work = retrax_take(block, points + 1, m, sizeof(double));
    to->square = retrax_take(block, z, z, sizeof(double));
    to->steady = retrax_take(block, E + problem->control_numbers, 1, sizeof(bool));
    to->workspace = retrax_take(block, 1, 1, retrax_workspace(problem));
    take_augmented(problem, block, &to->augmented);
    return own;
}

size_t retrax_search_memory(const retrax_layout *layout, retrax_index max_iterations) {
    retrax_block block = {NULL, 0};
    if (retrax_workspace(layout->problem) == 0 || max_iterations < 1 || max_iterations > MOST_ITERATIONS) {
        return 0;
    }
    lay_out(layout, max_iterations, &block);
    return block.used == SIZE_MAX ? 0 : block.used;
}

retrax_search *retrax_search_make(const retrax_layout *layout, const retrax_options *options,
                                  retrax_instruction_set set, void *memory) {
    retrax_block block = {memory, 0};
    retrax_search *const own = lay_out(layout, options->max_iterations, &block);
    own->layout = layout;
    own->options = *options;
    own->set = set;
    own->firm = options->firm;
    own->limits = (retrax_limit_scale){0.0, own->limit_sizes, RETRAX_FIRST_PENALTY, 0.5, 1e6};
    return own;
}

double *retrax_search_trajectory(retrax_search *search) { return search->at; }

retrax_search_result retrax_search_read(const retrax_search *search) {
    const retrax_direction *const step = &search->direction;
    const bool extremal = retrax_is_extremal(search);
    return (retrax_search_result){
        .trajectory = search->at,
        .first = search->first,
        .judging = search->judging,
        .steps = search->steps,
        .limits = search->limit_sizes,
        .rate = search->limits.rate,
        .iterations = search->trials - 1,
        .limited = search->trials > search->options.max_iterations,
        .claimed = extremal,
        .strict = search->strict,
        .convex = search->convex,
        .solvable = step->finite && step->shift < RETRAX_LARGEST_SHIFT,
        .infeasible = retrax_is_infeasible(search),
        .falls = !extremal && retrax_cost_falls(search),
        .stopped = search->stopped,
    };
}
