/*
 * Layout: where the arrays of a trajectory stand, and what the functions of the problem read and write there.
 */
#include "layout.h"

#include "workspace.h"

/* Bounds of the sizes of a problem, and of its steps and parameters: products of four sizes do not overflow. */
#define LARGEST_SIZE ((retrax_index)1 << 10)
#define MOST_STEPS ((retrax_index)1 << 20)
#define MOST_PARAMETERS ((retrax_index)1 << 20)

bool retrax_collocates(const retrax_problem *problem) { return problem->points > 1; }

double retrax_duration(const retrax_layout *layout, const double *trajectory) {
    double sum = 0.0;
    for (retrax_index k = 0; k < layout->problem->steps; k++) {
        sum += ARRAY(STEP_SIZE)[k];
    }
    return sum;
}

bool retrax_has_inequalities(const retrax_problem *problem) {
    return problem->inequalities > 0 || problem->node_inequalities > 0;
}

retrax_limit retrax_limit_of(const retrax_problem *problem, retrax_index i) {
    const retrax_index c = problem->inequalities, d = problem->node_inequalities, n = problem->state_size;
    const retrax_index q = retrax_point_unknowns(problem), of_points = problem->steps * problem->points * c;
    if (i < of_points) {
        return (retrax_limit){i % c, i / c, q, i * q, false};
    }
    const retrax_index own = i - of_points;
    return (retrax_limit){c + own % d, own / d, 2 * n, of_points * q + own * 2 * n, true};
}

retrax_index retrax_point_unknowns(const retrax_problem *problem) {
    return (retrax_collocates(problem) ? 3 : 1) * problem->state_size + problem->control_size;
}

/* ---------------------------------------------------------------------------------------------------- arrays */

const char *retrax_array_name(int array) {
#define RETRAX_WORD_OF(name, count) #name,
    static const char *const names[] = {RETRAX_ARRAYS(RETRAX_WORD_OF)};
#undef RETRAX_WORD_OF
    return array >= 0 && array < RETRAX_ARRAY_TOTAL ? names[array] : NULL;
}

/* Writes the number of entries of each array. */
static void count_arrays(const retrax_problem *problem, retrax_index *count) {
    const retrax_index N = problem->steps, s = problem->points, n = problem->state_size, E = problem->state_numbers;
    const retrax_index m = problem->control_size, U = problem->control_numbers, P = problem->parameters;
    const retrax_index c = problem->inequalities, d = problem->node_inequalities, l = N * s * c + N * d;
    const retrax_index g = problem->curved_controls ? 1 : 0, w = problem->node_costs;
    const retrax_index q = 3 * n + m, z = n + s * m, p = s * n;
    const retrax_index v = retrax_collocates(problem) ? N * s : 0;
#define RETRAX_COUNT_OF(name, number) count[RETRAX_ARRAY_##name] = (number);
    RETRAX_ARRAYS(RETRAX_COUNT_OF)
#undef RETRAX_COUNT_OF
}

/* Whether the sizes are within their bounds. */
static bool fits(const retrax_problem *problem) {
    const retrax_index sizes[] = {problem->points,          problem->state_size,   problem->state_numbers,
                                  problem->control_size,    problem->control_numbers,
                                  problem->inequalities,    problem->node_inequalities,
                                  problem->node_costs};
    for (size_t i = 0; i < sizeof(sizes) / sizeof(sizes[0]); i++) {
        if (sizes[i] < (i < 3 ? 1 : 0) || sizes[i] > LARGEST_SIZE) {
            return false;
        }
    }
    const bool of_nodes = problem->node_inequalities == 0 || retrax_collocates(problem);
    const bool of_controls = problem->curved_controls || problem->control_numbers == problem->control_size;
    const bool parameters = problem->parameters >= 0 && problem->parameters <= MOST_PARAMETERS;
    return problem->steps >= 1 && problem->steps <= MOST_STEPS && parameters && of_nodes && of_controls;
}

/* Writes where the arrays stand; returns the numbers of a trajectory, 0 if it exceeds the address space. */
static retrax_index place_arrays(const retrax_problem *problem, retrax_layout *layout) {
    retrax_block block = {NULL, 0};
    count_arrays(problem, layout->count);
    for (int array = 0; array < RETRAX_ARRAY_TOTAL; array++) {
        layout->first[array] = (retrax_index)(block.used / sizeof(double));
        retrax_take(&block, layout->count[array], 1, sizeof(double));
    }
    return block.used == SIZE_MAX ? 0 : (retrax_index)(block.used / sizeof(double));
}

/* ---------------------------------------------------------------------------------------- places of functions */

/* Arrays that a function reads or writes at one place, at most; with NEXT, that of the next place. */
#define MOST_ARRAYS 12
#define NEXT 1000
#define NONE RETRAX_ARRAY_TOTAL
#define A(name) RETRAX_ARRAY_##name
#define AROUND A(NODES), NEXT + A(NODES), A(NODE_COSTATES), NEXT + A(NODE_COSTATES) /* a step */

typedef enum { OF_MAP, OF_COLLOCATION, OF_BOTH } method;

/* What a function of a method reads and writes at one place. */
typedef struct {
    retrax_function_name name;
    method of;
    int in[MOST_ARRAYS], out[MOST_ARRAYS];
} function_arrays;

static const function_arrays arrays_of_functions[] = {
    {RETRAX_ENDS, OF_MAP, {A(CENTRES), A(CONTROLS), A(STEP_SIZE), A(PARAMETERS), NONE}, {A(BEGINS), A(FINISHES), NONE}},
    {RETRAX_ENDS, OF_COLLOCATION, {A(CENTRES), A(ETA), NONE}, {A(BEGINS), A(FINISHES), NONE}},
    {RETRAX_MIDDLE, OF_BOTH, {A(AMID_ENDS), NONE}, {A(AMID), NONE}},
    {RETRAX_FRAMES, OF_BOTH, {A(NODES), A(FIXED), A(GAPS), A(TURNED_COSTATES), NONE},
     {A(NODE_FRAMES), A(DEFECTS), A(MULTIPLIERS), A(NODE_COSTATES), NONE}},
    {RETRAX_POINTS, OF_MAP, {A(CENTRES), A(CONTROLS), AROUND, A(STEP_SIZE), A(PARAMETERS), A(LIMIT_MULTIPLIERS),
      A(NODE_INDICES), NONE},
     {A(HESSIANS), A(SLOPES), A(LEFT), A(RIGHT), A(GRADIENTS), A(LIMIT_JACOBIANS), A(END_COORDINATES), A(COSTS), A(LIMITS),
      NONE}},
    {RETRAX_POINTS, OF_COLLOCATION,
     {A(POINT_CENTRES), A(XI), A(VELOCITIES), A(CONTROLS), A(POINT_COSTATES), A(POINT_WEIGHTS), A(PARAMETERS),
      A(LIMIT_MULTIPLIERS), NONE},
     {A(POINT_HESSIANS), A(POINT_SLOPES), A(POINT_JACOBIANS), A(POINT_GRADIENTS), A(LIMIT_JACOBIANS), A(POINT_DEFECTS),
      A(POINT_COSTS), A(LIMITS), A(POINT_FRAMES), A(POINT_MULTIPLIERS), NONE}},
    {RETRAX_BOTH_ENDS, OF_COLLOCATION,
     {A(CENTRES), A(ETA), AROUND, A(STEP_SIZE), A(PARAMETERS), A(LIMIT_MULTIPLIERS), A(NODE_INDICES), NONE},
     {A(END_HESSIANS), A(END_SLOPES), A(END_LEFT), A(END_RIGHT), A(END_GRADIENTS), A(LIMIT_JACOBIANS), A(END_COORDINATES),
      A(END_COSTS), A(LIMITS), NONE}},
    {RETRAX_MOVE, OF_MAP, {A(CENTRES_BEFORE), A(CONTROLS_BEFORE), A(CENTRE_PARTS), A(STEP_SIZE), A(PARAMETERS), NONE},
     {A(CENTRES), A(CONTROLS), NONE}},
    {RETRAX_MOVE, OF_COLLOCATION, {A(CENTRES_BEFORE), A(CENTRE_PARTS), NONE}, {A(CENTRES), A(CARRIED), NONE}},
    {RETRAX_MOVE_CONTROLS, OF_COLLOCATION, {A(CONTROLS_BEFORE), A(CONTROL_PARTS), NONE}, {A(CONTROLS), NONE}},
    {RETRAX_START_COST, OF_BOTH, {A(NODES), A(PARAMETERS), NONE}, {A(START_COST), NONE}},
    {RETRAX_END_COST, OF_BOTH, {A(NODES), A(PARAMETERS), NONE}, {A(END_COST), NONE}},
    {RETRAX_CONTROL_FRAMES, OF_BOTH, {A(CONTROLS), NONE}, {A(CONTROL_FRAMES), NONE}},
};

/* The places at which a function is evaluated. */
static retrax_index places_of(const retrax_problem *problem, retrax_function_name name) {
    const retrax_index N = problem->steps;
    switch (name) {
        case RETRAX_POINTS:
        case RETRAX_MOVE_CONTROLS:
        case RETRAX_CONTROL_FRAMES:
            return N * problem->points;
        case RETRAX_FRAMES:
        case RETRAX_START_COST: /* these two at the first, and the last, of the nodes */
        case RETRAX_END_COST:
            return N + 1;
        case RETRAX_MIDDLE:
            return 1;
        default:
            return N;
    }
}

/* Numbers of an array at one place: `width` of them from number `offset` on, those of the next place `stride` farther. */
typedef struct {
    retrax_index offset, width, stride;
} part;

static part part_of(const retrax_problem *problem, const retrax_index *count, retrax_function_name name, int asked) {
    const retrax_index N = problem->steps, d = problem->node_inequalities, of_points = N * problem->points;
    const retrax_array array = (retrax_array)(asked % NEXT);
    const bool at_ends = name == RETRAX_BOTH_ENDS, of_ends = name == RETRAX_START_COST || name == RETRAX_END_COST;
    if (array == A(PARAMETERS) || array == A(STEP_SIZE)) {
        const bool any = !at_ends || d > 0 || problem->node_costs > 0;
        return (part){0, !any ? 0 : (array == A(PARAMETERS) ? problem->parameters : 1), array == A(STEP_SIZE) ? 1 : 0};
    }
    if (array == A(START_COST) || array == A(END_COST)) {
        return (part){0, count[array], count[array]};
    }
    if (array == A(LIMITS) || array == A(LIMIT_MULTIPLIERS) || array == A(LIMIT_JACOBIANS)) {
        const bool slopes = array == A(LIMIT_JACOBIANS);
        const retrax_index each = problem->inequalities * (slopes ? retrax_point_unknowns(problem) : 1);
        const retrax_index of_step = d * (slopes ? 2 * problem->state_size : 1);
        return at_ends ? (part){of_points * each, of_step, of_step} : (part){0, each, each};
    }
    const bool of_nodes = array == A(NODES) || array == A(NODE_COSTATES);
    const retrax_index width = count[array] / (of_nodes ? N + 1 : places_of(problem, name));
    const retrax_index first = asked >= NEXT ? 1 : (of_ends && name == RETRAX_END_COST ? N : 0);
    return (part){first * width, width, width};
}

/* What a function reads, or writes; nothing of one that the method does not have. */
static const int *arrays_of(const retrax_problem *problem, retrax_function_name name, bool out) {
    static const int nothing[] = {NONE};
    const method own = retrax_collocates(problem) ? OF_COLLOCATION : OF_MAP;
    for (size_t i = 0; i < sizeof(arrays_of_functions) / sizeof(arrays_of_functions[0]); i++) {
        const function_arrays *const found = &arrays_of_functions[i];
        if (found->name == name && (found->of == own || found->of == OF_BOTH)) {
            return out ? found->out : found->in;
        }
    }
    return nothing;
}

static retrax_index width_of(const retrax_problem *problem, retrax_function_name name, bool out) {
    retrax_index count[RETRAX_ARRAY_TOTAL], found = 0;
    count_arrays(problem, count);
    for (const int *array = arrays_of(problem, name, out); *array != NONE; array++) {
        found += part_of(problem, count, name, *array).width;
    }
    return found;
}

retrax_index retrax_function_inputs(const retrax_problem *problem, retrax_function_name name) {
    return width_of(problem, name, false);
}

retrax_index retrax_function_outputs(const retrax_problem *problem, retrax_function_name name) {
    return width_of(problem, name, true);
}

/* Takes the places of what a function reads, or writes, from a block and writes them. */
static const retrax_index (*take_places(retrax_block *block, const retrax_problem *problem, const retrax_layout *layout,
                                        retrax_function_name name, bool out))[2] {
    retrax_index(*const places)[2] = retrax_take(block, width_of(problem, name, out), 2, sizeof(retrax_index));
    retrax_index k = 0;
    for (const int *array = arrays_of(problem, name, out); *array != NONE && places != NULL; array++) {
        const part own = part_of(problem, layout->count, name, *array);
        for (retrax_index j = 0; j < own.width; j++, k++) {
            places[k][0] = layout->first[*array % NEXT] + own.offset + j;
            places[k][1] = own.stride;
        }
    }
    return (const retrax_index(*)[2])places;
}

/* Takes the places of all functions from a block. */
static void take_all_places(const retrax_problem *problem, retrax_block *block, retrax_layout *layout) {
    for (int name = 0; name < RETRAX_FUNCTIONS; name++) {
        layout->sources[name] = take_places(block, problem, layout, (retrax_function_name)name, false);
        layout->targets[name] = take_places(block, problem, layout, (retrax_function_name)name, true);
    }
}

size_t retrax_layout_memory(const retrax_problem *problem) {
    retrax_layout layout;
    retrax_block block = {NULL, 0};
    if (!fits(problem) || place_arrays(problem, &layout) == 0) {
        return 0;
    }
    take_all_places(problem, &block, &layout);
    return block.used == SIZE_MAX ? 0 : block.used;
}

void retrax_layout_make(const retrax_problem *problem, void *memory, retrax_layout *layout) {
    retrax_block block = {memory, 0};
    layout->problem = problem;
    layout->numbers = place_arrays(problem, layout);
    take_all_places(problem, &block, layout);
}


/* The larger of both sizes; 0, which says that something does not fit, if one of them is 0. */
static size_t larger_of(size_t a, size_t b) { return a == 0 || b == 0 ? 0 : (a > b ? a : b); }

size_t retrax_workspace(const retrax_problem *problem) {
    if (!fits(problem)) {
        return 0;
    }
    const retrax_index n = problem->state_size, z = n + problem->points * problem->control_size;
    size_t found = retrax_block_workspace(problem->steps, n, z, 1);
    found = larger_of(found, retrax_scaling_workspace(problem));
    return retrax_collocates(problem)
               ? larger_of(found, retrax_condensing_workspace(problem->points, n, problem->control_size, 1))
               : found;
}
