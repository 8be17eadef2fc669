/*
 * Searches of random trajectories, alone or coupled, in memory of exactly its size: for the sanitizers and valgrind.
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

/* A phase with all that its problem refers to. */
typedef struct {
    retrax_problem problem;
    double matrix[9], weights[3], kept[8];
    retrax_index columns[8], control_columns[8];
    source sources[RETRAX_FUNCTIONS];
    retrax_layout layout;
    void *places;
} phase;

static void make_phase(generator *g, phase *own, bool coupled) {
    const retrax_index s = below(g, 2) == 0 ? 1 : 2 + below(g, 2), n = 1 + below(g, 3), E = n + below(g, 2);
    const retrax_index m = below(g, 3), curved = below(g, 4) == 0 && m > 0;
    own->problem = (retrax_problem){
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
        .coupled = coupled,
    };
    for (int i = 0; i < 9; i++) {
        own->matrix[i] = 0.3 * number(g);
        own->weights[i % 3] = 1.0 / (double)s;
    }
    for (int i = 0; i < 8; i++) {
        own->columns[i] = i < E ? below(g, E) : 0;
        own->control_columns[i] = 0;
        own->kept[i] = below(g, 5) == 0 ? 1.0 : 0.0;
    }
    own->problem.matrix = own->matrix;
    own->problem.weights = own->weights;
    own->problem.columns = own->problem.arrays = own->columns;
    own->problem.control_columns = own->problem.control_arrays = own->control_columns;
    own->problem.never_elastic = own->kept;
    own->problem.bounds = below(g, own->problem.inequalities + 1);
    const int smooth = below(g, 2) == 0;
    for (int name = 0; name < RETRAX_FUNCTIONS; name++) {
        const bool optional = name == RETRAX_START_COST || name == RETRAX_END_COST;
        own->sources[name] = (source){g, retrax_function_inputs(&own->problem, (retrax_function_name)name),
                                      retrax_function_outputs(&own->problem, (retrax_function_name)name), smooth};
        own->problem.functions[name].context = &own->sources[name];
        own->problem.functions[name].evaluate = optional && below(g, 2) == 0 ? NULL : evaluate;
    }
    own->places = allocate(retrax_layout_memory(&own->problem));
    retrax_layout_make(&own->problem, own->places, &own->layout);
}

/* Writes what is given of a phase, and a guess. */
static void guess_phase(generator *g, const retrax_layout *layout, double *guess) {
    static const retrax_array given[] = {
        RETRAX_ARRAY_PARAMETERS, RETRAX_ARRAY_START,      RETRAX_ARRAY_END,      RETRAX_ARRAY_START_ENTRIES,
        RETRAX_ARRAY_END_ENTRIES, RETRAX_ARRAY_FIXED,     RETRAX_ARRAY_CENTRES,  RETRAX_ARRAY_VELOCITIES,
        RETRAX_ARRAY_CONTROLS,   RETRAX_ARRAY_POINT_COSTATES, RETRAX_ARRAY_COSTATES, RETRAX_ARRAY_LIMIT_MULTIPLIERS};
    const bool warm = below(g, 2) == 0; /* whether multipliers of inequalities are known */
    const bool free_ends = layout->problem->coupled;
    for (size_t k = 0; k < sizeof given / sizeof *given; k++) {
        for (retrax_index i = 0; i < layout->count[given[k]]; i++) {
            const bool unknown = given[k] == RETRAX_ARRAY_LIMIT_MULTIPLIERS && !warm;
            guess[layout->first[given[k]] + i] = unknown ? 0.0 : number(g);
        }
    }
    for (retrax_index i = 0; i < layout->count[RETRAX_ARRAY_FIXED] && free_ends; i++) {
        const retrax_index n = layout->problem->state_size, node = i / n;
        const bool inner = node > 0 && node < layout->problem->steps;
        guess[layout->first[RETRAX_ARRAY_FIXED] + i] = inner || below(g, 3) == 0 ? 1.0 : 0.0;
    }
    for (retrax_index i = 0; i < layout->count[RETRAX_ARRAY_STEP_SIZE]; i++) {
        guess[layout->first[RETRAX_ARRAY_STEP_SIZE] + i] = 0.5;
    }
    for (retrax_index i = 0; i < layout->count[RETRAX_ARRAY_LIMIT_WEIGHTS]; i++) {
        guess[layout->first[RETRAX_ARRAY_LIMIT_WEIGHTS] + i] = below(g, 5) == 0 ? 0.0 : 0.5;
    }
}

/* Couples the ends of phases by equations and links of random sizes. */
static retrax_multiphase couple(generator *g, retrax_index count, const phase *phases,
                                const retrax_layout *const *layouts, retrax_link *links, source *own) {
    retrax_multiphase found = {.phases = count, .layouts = layouts, .equations = below(g, 3), .links = below(g, 3), .link = links};
    retrax_index e = 0, Z = 0, p = 0, M = found.equations, r = found.equations;
    for (retrax_index k = 0; k < count; k++) {
        e += 2 * phases[k].problem.state_numbers;
        Z += 2 * phases[k].problem.state_size;
        p += phases[k].problem.parameters;
    }
    for (retrax_index i = 0; i < found.links; i++) {
        const retrax_index target = below(g, 2 * count);
        links[i] = (retrax_link){target, phases[target / 2].problem.state_size, phases[target / 2].problem.state_numbers};
        r += links[i].size;
        M += links[i].numbers;
    }
    const retrax_index apart = M - found.equations;
    *own = (source){g, e + p + M, Z * Z + Z + r * Z + r + e + apart + 2 * count + r, below(g, 2) == 0};
    found.function = (retrax_function){evaluate, own};
    return found;
}

/* Searches once; returns the number of the rule that was broken, 0 if none was. */
static int try_search(generator *g) {
    const retrax_index count = below(g, 2) == 0 ? 1 : 1 + below(g, 3);
    const bool coupled = count > 1 || below(g, 2) == 0;
    phase phases[3];
    const retrax_layout *layouts[3];
    retrax_link links[2];
    source between;
    for (retrax_index k = 0; k < count; k++) {
        make_phase(g, &phases[k], coupled);
        layouts[k] = &phases[k].layout;
    }
    const retrax_multiphase problem = coupled ? couple(g, count, phases, layouts, links, &between)
                                              : (retrax_multiphase){.phases = 1, .layouts = layouts};
    const retrax_options options = {TOLERANCE, 1 + below(g, 20), 1.0, 1.0, below(g, 2) == 0, report, g};
    void *const memory = allocate(retrax_search_memory(&problem, options.max_iterations));
    retrax_search *const search =
        retrax_search_make(&problem, &options, (retrax_instruction_set)below(g, 1 + retrax_best_instruction_set()), memory);
    for (retrax_index k = 0; k < count; k++) {
        guess_phase(g, layouts[k], retrax_search_trajectory(search, k));
    }
    if (coupled) {
        double *const multipliers = retrax_search_multipliers(search, false);
        retrax_index M = problem.equations;
        for (retrax_index i = 0; i < problem.links; i++) {
            M += links[i].numbers;
        }
        for (retrax_index i = 0; i < M; i++) {
            multipliers[i] = number(g);
        }
    }

    int broken = 0;
    retrax_search_status status = retrax_search_run(search);
    if (!coupled && (status == RETRAX_DEGENERATE || below(g, 4) == 0)) {
        double draws[3 * 3 * 2]; /* [waves][s m] */
        for (size_t i = 0; i < sizeof draws / sizeof *draws; i++) {
            draws[i] = number(g);
        }
        retrax_search_perturb(search, draws);
        status = retrax_search_run(search);
        broken = status == RETRAX_DEGENERATE ? 4 : 0;
    }
    broken = status <= RETRAX_GOING_ON || status > RETRAX_STOPPED ? 1 : broken;
    const bool restores = below(g, 3) == 0;
    for (retrax_index k = 0; k < count; k++) {
        const retrax_search_result found = retrax_search_read(search, k);
        const double final = found.trajectory[layouts[k]->first[RETRAX_ARRAY_RESIDUALS] + RETRAX_KKT_ERROR];
        broken = found.converged && !(final <= TOLERANCE) ? 2 : broken;
        broken = found.iterations < 0 || found.iterations > options.max_iterations + 5 ? 3 : broken;
    }
    if (restores && !broken) { /* from the iterate; a search may set out from what is found */
        const retrax_index most = below(g, 30);
        const retrax_feasibility found = retrax_search_restore(search, most);
        broken = found.trials < 0 || found.trials > most || (found.holds && !found.feasible) ? 5 : 0;
        status = retrax_search_run(search);
        broken = status <= RETRAX_GOING_ON || status > RETRAX_STOPPED ? 1 : broken;
    }
    for (retrax_index k = 0; k < count; k++) {
        free(phases[k].places);
    }
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
