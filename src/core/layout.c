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

bool retrax_is_limited(const retrax_problem *problem) {
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

/* What a function reads or writes at one place: `width` numbers of an array, from number `offset` on; the numbers of
 * the next place are `stride` farther. */
typedef struct {
    retrax_array array;
    retrax_index offset, width, stride;
} part;

/* The parts that a function reads or writes. */
typedef struct {
    part parts[16];
    int count;
} part_list;

static void add(part_list *list, retrax_array array, retrax_index width) {
    list->parts[list->count++] = (part){array, 0, width, width};
}

static void add_strided(part_list *list, retrax_array array, retrax_index offset, retrax_index width,
                        retrax_index stride) {
    list->parts[list->count++] = (part){array, offset, width, stride};
}

/* States and covectors of the nodes on either side of a step. */
static void add_around(part_list *list, retrax_index E) {
    add(list, RETRAX_ARRAY_NODES, E);
    add_strided(list, RETRAX_ARRAY_NODES, E, E, E);
    add(list, RETRAX_ARRAY_NODE_COSTATES, E);
    add_strided(list, RETRAX_ARRAY_NODE_COSTATES, E, E, E);
}

/* Lists what a function of a discretization map reads and writes. */
static void list_of_map(const retrax_problem *problem, retrax_function_name name, part_list *in, part_list *out) {
    const retrax_index n = problem->state_size, E = problem->state_numbers, U = problem->control_numbers;
    const retrax_index c = problem->inequalities, z = n + problem->control_size;
    switch (name) {
        case RETRAX_ENDS:
            add(in, RETRAX_ARRAY_CENTRES, E);
            add(in, RETRAX_ARRAY_CONTROLS, U);
            add(in, RETRAX_ARRAY_STEP_SIZE, 1);
            add_strided(in, RETRAX_ARRAY_PARAMETERS, 0, problem->parameters, 0);
            break;
        case RETRAX_POINTS:
            add(in, RETRAX_ARRAY_CENTRES, E);
            add(in, RETRAX_ARRAY_CONTROLS, U);
            add_around(in, E);
            add(in, RETRAX_ARRAY_STEP_SIZE, 1);
            add_strided(in, RETRAX_ARRAY_PARAMETERS, 0, problem->parameters, 0);
            add(in, RETRAX_ARRAY_LIMIT_MULTIPLIERS, c);
            add(in, RETRAX_ARRAY_NODE_INDICES, problem->node_costs);
            add(out, RETRAX_ARRAY_HESSIANS, z * z);
            add(out, RETRAX_ARRAY_SLOPES, z);
            add(out, RETRAX_ARRAY_LEFT, n * z);
            add(out, RETRAX_ARRAY_RIGHT, n * z);
            add(out, RETRAX_ARRAY_GRADIENTS, z);
            add(out, RETRAX_ARRAY_LIMIT_JACOBIANS, c * z);
            add(out, RETRAX_ARRAY_END_COORDINATES, 2 * n);
            add(out, RETRAX_ARRAY_COSTS, 1);
            add(out, RETRAX_ARRAY_LIMITS, c);
            break;
        case RETRAX_MOVE:
            add(in, RETRAX_ARRAY_CENTRES_BEFORE, E);
            add(in, RETRAX_ARRAY_CONTROLS_BEFORE, U);
            add(in, RETRAX_ARRAY_CENTRE_PARTS, z);
            add(in, RETRAX_ARRAY_STEP_SIZE, 1);
            add_strided(in, RETRAX_ARRAY_PARAMETERS, 0, problem->parameters, 0);
            add(out, RETRAX_ARRAY_CENTRES, E);
            add(out, RETRAX_ARRAY_CONTROLS, U);
            break;
        default:
            break;
    }
}

/* Lists what a function of a collocation method reads and writes. */
static void list_of_collocation(const retrax_problem *problem, retrax_function_name name, part_list *in,
                                part_list *out) {
    const retrax_index n = problem->state_size, E = problem->state_numbers, U = problem->control_numbers;
    const retrax_index m = problem->control_size, c = problem->inequalities, q = 3 * n + m;
    const retrax_index d = problem->node_inequalities, of_points = problem->steps * problem->points * c;
    const retrax_index w = problem->node_costs;
    switch (name) {
        case RETRAX_ENDS:
            add(in, RETRAX_ARRAY_CENTRES, E);
            add(in, RETRAX_ARRAY_ETA, n);
            break;
        case RETRAX_POINTS:
            add(in, RETRAX_ARRAY_POINT_CENTRES, E);
            add(in, RETRAX_ARRAY_XI, n);
            add(in, RETRAX_ARRAY_VELOCITIES, n);
            add(in, RETRAX_ARRAY_CONTROLS, U);
            add(in, RETRAX_ARRAY_POINT_COSTATES, E);
            add(in, RETRAX_ARRAY_POINT_WEIGHTS, 1);
            add_strided(in, RETRAX_ARRAY_PARAMETERS, 0, problem->parameters, 0);
            add(in, RETRAX_ARRAY_LIMIT_MULTIPLIERS, c);
            add(out, RETRAX_ARRAY_POINT_HESSIANS, q * q);
            add(out, RETRAX_ARRAY_POINT_SLOPES, q);
            add(out, RETRAX_ARRAY_POINT_JACOBIANS, n * q);
            add(out, RETRAX_ARRAY_POINT_GRADIENTS, q);
            add(out, RETRAX_ARRAY_LIMIT_JACOBIANS, c * q);
            add(out, RETRAX_ARRAY_POINT_DEFECTS, n);
            add(out, RETRAX_ARRAY_POINT_COSTS, 1);
            add(out, RETRAX_ARRAY_LIMITS, c);
            add(out, RETRAX_ARRAY_POINT_FRAMES, n * E);
            add(out, RETRAX_ARRAY_POINT_MULTIPLIERS, n);
            break;
        case RETRAX_BOTH_ENDS:
            add(in, RETRAX_ARRAY_CENTRES, E);
            add(in, RETRAX_ARRAY_ETA, n);
            add_around(in, E);
            if (d > 0 || w > 0) {
                add(in, RETRAX_ARRAY_STEP_SIZE, 1);
                add_strided(in, RETRAX_ARRAY_PARAMETERS, 0, problem->parameters, 0);
                add_strided(in, RETRAX_ARRAY_LIMIT_MULTIPLIERS, of_points, d, d);
                add(in, RETRAX_ARRAY_NODE_INDICES, w);
            }
            add(out, RETRAX_ARRAY_END_HESSIANS, 4 * n * n);
            add(out, RETRAX_ARRAY_END_SLOPES, 2 * n);
            add(out, RETRAX_ARRAY_END_LEFT, 2 * n * n);
            add(out, RETRAX_ARRAY_END_RIGHT, 2 * n * n);
            add(out, RETRAX_ARRAY_END_GRADIENTS, w * 2 * n);
            add_strided(out, RETRAX_ARRAY_LIMIT_JACOBIANS, of_points * q, d * 2 * n, d * 2 * n);
            add(out, RETRAX_ARRAY_END_COORDINATES, 2 * n);
            add(out, RETRAX_ARRAY_END_COSTS, w);
            add_strided(out, RETRAX_ARRAY_LIMITS, of_points, d, d);
            break;
        case RETRAX_MOVE:
            add(in, RETRAX_ARRAY_CENTRES_BEFORE, E);
            add(in, RETRAX_ARRAY_CENTRE_PARTS, n);
            add(out, RETRAX_ARRAY_CENTRES, E);
            add(out, RETRAX_ARRAY_CARRIED, n * n);
            break;
        case RETRAX_MOVE_CONTROLS:
            add(in, RETRAX_ARRAY_CONTROLS_BEFORE, U);
            add(in, RETRAX_ARRAY_CONTROL_PARTS, m);
            add(out, RETRAX_ARRAY_CONTROLS, U);
            break;
        default:
            break;
    }
}

/* Lists what a function reads and writes; nothing of one that the method does not have. */
static void list(const retrax_problem *problem, retrax_function_name name, part_list *in, part_list *out) {
    const retrax_index n = problem->state_size, E = problem->state_numbers;
    in->count = 0;
    out->count = 0;
    (retrax_collocates(problem) ? list_of_collocation : list_of_map)(problem, name, in, out);
    switch (name) {
        case RETRAX_ENDS:
            add(out, RETRAX_ARRAY_BEGINS, E);
            add(out, RETRAX_ARRAY_FINISHES, E);
            break;
        case RETRAX_MIDDLE: /* of one node at a time, in the array of its own */
            add_strided(in, RETRAX_ARRAY_AMID, 0, 2 * E, 0);
            add_strided(out, RETRAX_ARRAY_AMID, 2 * E, E, 0);
            break;
        case RETRAX_FRAMES:
            add(in, RETRAX_ARRAY_NODES, E);
            add(in, RETRAX_ARRAY_FIXED, n);
            add(in, RETRAX_ARRAY_GAPS, E);
            add(in, RETRAX_ARRAY_TURNED_COSTATES, E);
            add(out, RETRAX_ARRAY_NODE_FRAMES, n * E);
            add(out, RETRAX_ARRAY_DEFECTS, n);
            add(out, RETRAX_ARRAY_MULTIPLIERS, n);
            add(out, RETRAX_ARRAY_NODE_COSTATES, E);
            break;
        case RETRAX_CONTROL_FRAMES:
            add(in, RETRAX_ARRAY_CONTROLS, problem->control_numbers);
            add(out, RETRAX_ARRAY_CONTROL_FRAMES, problem->control_size * problem->control_numbers);
            break;
        case RETRAX_START_COST:
            add(in, RETRAX_ARRAY_NODES, E);
            add_strided(in, RETRAX_ARRAY_PARAMETERS, 0, problem->parameters, 0);
            add(out, RETRAX_ARRAY_START_COST, 1 + E + n + n * n);
            break;
        case RETRAX_END_COST:
            add_strided(in, RETRAX_ARRAY_NODES, problem->steps * E, E, E);
            add_strided(in, RETRAX_ARRAY_PARAMETERS, 0, problem->parameters, 0);
            add(out, RETRAX_ARRAY_END_COST, 1 + E + n + n * n);
            break;
        default:
            break;
    }
}

static retrax_index width_of(const part_list *parts) {
    retrax_index found = 0;
    for (int i = 0; i < parts->count; i++) {
        found += parts->parts[i].width;
    }
    return found;
}

retrax_index retrax_function_inputs(const retrax_problem *problem, retrax_function_name name) {
    part_list in, out;
    list(problem, name, &in, &out);
    return width_of(&in);
}

retrax_index retrax_function_outputs(const retrax_problem *problem, retrax_function_name name) {
    part_list in, out;
    list(problem, name, &in, &out);
    return width_of(&out);
}

/* Takes the places of some parts from a block and writes them. */
static const retrax_index (*take_places(retrax_block *block, const retrax_layout *layout, const part_list *parts))[2] {
    retrax_index(*const places)[2] = retrax_take(block, width_of(parts), 2, sizeof(retrax_index));
    if (places == NULL) {
        return NULL;
    }
    retrax_index k = 0;
    for (int i = 0; i < parts->count; i++) {
        const part *const own = &parts->parts[i];
        for (retrax_index j = 0; j < own->width; j++, k++) {
            places[k][0] = layout->first[own->array] + own->offset + j;
            places[k][1] = own->stride;
        }
    }
    return (const retrax_index(*)[2])places;
}

/* Takes the places of all functions from a block. */
static void take_all_places(const retrax_problem *problem, retrax_block *block, retrax_layout *layout) {
    for (int name = 0; name < RETRAX_FUNCTIONS; name++) {
        part_list in, out;
        list(problem, (retrax_function_name)name, &in, &out);
        layout->sources[name] = take_places(block, layout, &in);
        layout->targets[name] = take_places(block, layout, &out);
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
