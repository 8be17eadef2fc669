/*
 * The memory of a search.
 */
#include "search.h"
#include "workspace.h"

/* Bound of the iterations of a search, whose costs are kept. */
#define MOST_ITERATIONS ((retrax_index)1 << 20)

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
    return (retrax_search_result){
        .trajectory = search->at,
        .first = search->first,
        .judging = search->judging,
        .steps = search->steps,
        .limits = search->limit_sizes,
        .rate = search->limits.rate,
        .iterations = search->trials - 1,
        .claimed = search->claimed && search->at[search->layout->first[RETRAX_ARRAY_RESIDUALS] + RETRAX_FINAL] <=
                                          search->options.tolerance,
        .isolated = search->isolated,
        .strict = step->strict && step->shift == 0.0,
        .solvable = step->finite && step->shift < RETRAX_LARGEST_SHIFT,
        .infeasible = retrax_is_infeasible(search),
        .falls = retrax_cost_falls(search),
        .stopped = search->stopped,
    };
}
