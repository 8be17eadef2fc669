/*
 * Searches of random trajectories in memory of exactly its size: for the sanitizers and valgrind.
 *
 * usage: fuzz_search COUNT SEED
 *
 * The functions of a problem return numbers that fit to nothing: random ones, or smooth functions of what they read, whose
 * derivatives are wrong. A search has to end all the same, and what it calls an extremal has residuals within the tolerance.
 */
#define _POSIX_C_SOURCE 200112L /* posix_memalign */
#include "fuzz.h"

#include <stdio.h>
#include <stdlib.h>

#define TOLERANCE 1e-8

/* A function of the problem, and where its numbers come from. */
typedef struct {
    generator *g;
    retrax_index inputs, outputs;
    int smooth; /* whether they are a function of what is read */
} source;

static void evaluate(void *context, const retrax_tape_data *data, retrax_index points) {
    const source *const own = context;
    for (retrax_index k = 0; k < points; k++) {
        double sum = 0.0;
        for (retrax_index i = 0; i < own->inputs; i++) {
            sum += data->inputs[data->sources[i][0] + k * data->sources[i][1]];
        }
        for (retrax_index j = 0; j < own->outputs; j++) {
            const double found = own->smooth ? sin(sum + (double)j) : number(own->g);
            data->outputs[data->targets[j][0] + k * data->targets[j][1]] = found;
        }
    }
}

/* Asks to stop now and then. */
static bool report(void *context, const retrax_iteration *iteration) {
    return iteration->number > 3 && below(context, 20) == 0;
}

static void *allocate(size_t size) {
    void *found = NULL;
    if (size == 0 || posix_memalign(&found, 64, size) != 0) {
        abort();
    }
    return found;
}

/* Searches once; returns the number of the rule that was broken, 0 if none was. */
static int try_search(generator *g) {
    const retrax_index s = below(g, 2) == 0 ? 1 : 2 + below(g, 2), n = 1 + below(g, 3), E = n + below(g, 2);
    const retrax_index m = below(g, 3), curved = below(g, 4) == 0 && m > 0;
    retrax_problem problem = {
        .steps = 1 + below(g, 4),
        .points = s,
        .state_size = n,
        .state_numbers = E,
        .control_size = m,
        .control_numbers = m + (curved ? 1 : 0),
        .parameters = below(g, 2),
        .inequalities = below(g, 3),
        .node_inequalities = s > 1 ? 2 * below(g, 2) : 0,
        .curved_controls = curved != 0,
    };
    double matrix[9], weights[3], kept[8] = {0.0};
    retrax_index columns[8], control_columns[8];
    source sources[RETRAX_FUNCTIONS];
    for (int i = 0; i < 9; i++) {
        matrix[i] = 0.3 * number(g);
        weights[i % 3] = 1.0 / (double)s;
    }
    for (int i = 0; i < 8; i++) {
        columns[i] = i < E ? below(g, E) : 0;
        control_columns[i] = 0;
        kept[i] = below(g, 5) == 0 ? 1.0 : 0.0;
    }
    problem.matrix = matrix;
    problem.weights = weights;
    problem.columns = problem.arrays = columns;
    problem.control_columns = problem.control_arrays = control_columns;
    problem.kept = kept;
    problem.bounds = below(g, problem.inequalities + 1);
    const int smooth = below(g, 2) == 0;
    for (int name = 0; name < RETRAX_FUNCTIONS; name++) {
        const bool optional = name == RETRAX_START_COST || name == RETRAX_END_COST;
        sources[name] = (source){g, retrax_function_inputs(&problem, (retrax_function_name)name),
                                 retrax_function_outputs(&problem, (retrax_function_name)name), smooth};
        problem.functions[name].context = &sources[name];
        problem.functions[name].evaluate = optional && below(g, 2) == 0 ? NULL : evaluate;
    }

    retrax_layout layout;
    void *const places = allocate(retrax_layout_memory(&problem));
    retrax_layout_make(&problem, places, &layout);
    const retrax_options options = {TOLERANCE, 1 + below(g, 20), 1.0, 1.0, below(g, 2) == 0, report, g};
    void *const memory = allocate(retrax_search_memory(&layout, options.max_iterations));
    retrax_search *const search =
        retrax_search_make(&layout, &options, (retrax_instruction_set)below(g, 1 + retrax_best_instruction_set()), memory);
    double *const guess = retrax_search_trajectory(search);
    static const retrax_array given[] = {
        RETRAX_ARRAY_PARAMETERS, RETRAX_ARRAY_START,      RETRAX_ARRAY_END,      RETRAX_ARRAY_START_ENTRIES,
        RETRAX_ARRAY_END_ENTRIES, RETRAX_ARRAY_FIXED,     RETRAX_ARRAY_CENTRES,  RETRAX_ARRAY_VELOCITIES,
        RETRAX_ARRAY_CONTROLS,   RETRAX_ARRAY_POINT_COSTATES, RETRAX_ARRAY_COSTATES, RETRAX_ARRAY_LIMIT_MULTIPLIERS};
    const bool warm = below(g, 2) == 0; /* whether multipliers of inequalities are known */
    for (size_t k = 0; k < sizeof given / sizeof *given; k++) {
        for (retrax_index i = 0; i < layout.count[given[k]]; i++) {
            const bool unknown = given[k] == RETRAX_ARRAY_LIMIT_MULTIPLIERS && !warm;
            guess[layout.first[given[k]] + i] = unknown ? 0.0 : number(g);
        }
    }
    for (retrax_index i = 0; i < layout.count[RETRAX_ARRAY_STEP_SIZE]; i++) {
        guess[layout.first[RETRAX_ARRAY_STEP_SIZE] + i] = 0.5;
    }
    for (retrax_index i = 0; i < layout.count[RETRAX_ARRAY_LIMIT_WEIGHTS]; i++) {
        guess[layout.first[RETRAX_ARRAY_LIMIT_WEIGHTS] + i] = below(g, 5) == 0 ? 0.0 : 0.5;
    }

    int broken = 0;
    retrax_search_status status = retrax_search_run(search);
    if (status == RETRAX_DEGENERATE || below(g, 4) == 0) {
        double draws[3 * 3 * 2]; /* [waves][s m] */
        for (size_t i = 0; i < sizeof draws / sizeof *draws; i++) {
            draws[i] = number(g);
        }
        retrax_search_perturb(search, draws);
        status = retrax_search_run(search);
        broken = status == RETRAX_DEGENERATE ? 4 : 0;
    }
    const retrax_search_result found = retrax_search_read(search);
    const double final = found.trajectory[layout.first[RETRAX_ARRAY_RESIDUALS] + RETRAX_FINAL];
    broken = status <= RETRAX_GOING_ON || status > RETRAX_STOPPED ? 1 : broken;
    broken = found.claimed && !(final <= TOLERANCE) ? 2 : broken;
    broken = found.iterations < 0 || found.iterations > options.max_iterations + 5 ? 3 : broken;
    free(places);
    free(memory);
    return broken;
}

int main(int argc, char **argv) {
    if (argc != 3) {
        fprintf(stderr, "usage: fuzz_search COUNT SEED\n");
        return 2;
    }
    const long count = atol(argv[1]);
    generator g = {0x9E3779B97F4A7C15u ^ (uint64_t)atol(argv[2]), 0};
    for (long k = 0; k < count; k++) {
        g.hard = k % 2 == 0 ? 0 : (int)(2 + below(&g, 400));
        const int broken = try_search(&g);
        if (broken) {
            fprintf(stderr, "search %ld breaks rule %d\n", k, broken);
            return 1;
        }
    }
    printf("searches that ran: %ld\n", count);
    return 0;
}
