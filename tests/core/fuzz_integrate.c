/*
 * Integrates random systems in arrays of exactly their size: for the sanitizers and valgrind.
 *
 * usage: fuzz_integrate COUNT SEED
 *
 * The method is that of Euler backward, c = s + h (A c + k c^3), with the next state c. A trajectory that has stopped
 * stays where it is; a step that is made solves its equations; where numbers are soft, every step is made, and the
 * number of lanes changes nothing but rounding.
 */
#define _POSIX_C_SOURCE 200112L /* posix_memalign */
#include "fuzz.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define LARGEST 5  /* unknowns */
#define SUBSTEPS 3 /* the largest number */

/* A system, and the function that a context is of. */
typedef struct {
    double matrix[LARGEST][LARGEST], cube, control;
    double sizes[LARGEST]; /* scaling factors of the unknowns */
    double usable;
    retrax_index m, controls;
} system_of;

typedef struct {
    const system_of *system;
    retrax_step_function name;
} context_of;

static void *allocate(size_t size) {
    void *found = NULL;
    if (posix_memalign(&found, 64, size > 0 ? size : 64) != 0) {
        abort();
    }
    memset(found, 0xff, size); /* NaN: nothing may depend on what was there */
    return found;
}

static double *numbers(retrax_index count) { return allocate(sizeof(double) * (size_t)count); }

/* Entry i of A c + k c^3, or with a direction d of its derivative along d. */
static double slope_of(const system_of *own, const double *c, const double *d, retrax_index i) {
    double sum = d == NULL ? own->cube * c[i] * c[i] * c[i] : 3.0 * own->cube * c[i] * c[i] * d[i];
    for (retrax_index j = 0; j < own->m; j++) {
        sum += own->matrix[i][j] * (d == NULL ? c[j] : d[j]);
    }
    return sum;
}

/* Size of the parts of equation i, at unknowns as large as their scaling factors: rounding is relative to that. */
static double parts_of(const system_of *own, const double *c, double state, double h, retrax_index i) {
    const double x = fabs(c[i]) + own->sizes[i];
    double sum = x + fabs(state) + 3.0 * fabs(h * own->cube * x * x * x);
    for (retrax_index j = 0; j < own->m; j++) {
        sum += fabs(h * own->matrix[i][j]) * (fabs(c[j]) + own->sizes[j]);
    }
    return sum;
}

/* A function of the method; reads unknowns or state, h, state or direction, as `places_of` says. */
static void evaluate(void *context, const retrax_tape_data *data, retrax_index points) {
    const context_of *const own = context;
    const system_of *const of = own->system;
    const retrax_index m = of->m;
    for (retrax_index p = 0; p < points; p++) {
        double x[2 * LARGEST + 1], y[2 * LARGEST + 3];
        for (retrax_index i = 0; i < 2 * m + 1; i++) {
            x[i] = data->inputs[data->sources[i][0] + p * data->sources[i][1]];
        }
        const double h = x[m], *const c = x, *const other = x + m + 1;
        for (retrax_index i = 0; i < m; i++) {
            const double missed = c[i] - other[i] - h * slope_of(of, c, NULL, i);
            const double pushed = other[i] - h * slope_of(of, c, other, i);
            y[i] = own->name == RETRAX_STEP_RESIDUAL ? missed : (own->name == RETRAX_STEP_PUSH ? pushed : c[i]);
            y[m + i] = own->name == RETRAX_STEP_PREPARE ? of->sizes[i] : (i == 0 ? of->usable : of->control);
        }
        y[m + of->controls] = own->name == RETRAX_STEP_END ? of->usable : y[m + of->controls];
        const retrax_index count[] = {2 * m, m, m, m + of->controls + 1};
        for (retrax_index i = 0; i < count[own->name]; i++) {
            data->outputs[data->targets[i][0] + p * data->targets[i][1]] = y[i];
        }
    }
}

/* A method with all its arrays. */
typedef struct {
    retrax_method method;
    context_of contexts[RETRAX_STEP_FUNCTIONS];
    retrax_index (*sources[RETRAX_STEP_FUNCTIONS])[2], (*targets[RETRAX_STEP_FUNCTIONS])[2];
    double *parts, *inverse;
} built;

/* Rows of consecutive numbers as places. */
static void write_places(retrax_index (*places)[2], retrax_index first, retrax_index count, retrax_index apart,
                         retrax_index step) {
    for (retrax_index i = 0; i < count; i++) {
        places[i][0] = (first + i) * apart;
        places[i][1] = step;
    }
}

/* Places of what the functions read and write. */
static void write_all_places(built *own, retrax_index m, retrax_index U, retrax_index L) {
    const retrax_index *const first = own->method.first, R = own->method.rows;
    for (int k = 0; k < RETRAX_STEP_FUNCTIONS; k++) {
        const retrax_index step = k == RETRAX_STEP_PUSH && L == 1 ? 0 : 1;
        retrax_index(*const sources)[2] = own->sources[k] = allocate(sizeof *sources * (size_t)(2 * m + 1));
        const retrax_index begin = k == RETRAX_STEP_PREPARE ? RETRAX_ROWS_STATE : RETRAX_ROWS_UNKNOWNS;
        write_places(sources, first[begin], m, L, step);
        write_places(sources + m, first[RETRAX_ROWS_STEP_SIZE], 1, L, step);
        write_places(sources + m + 1, first[RETRAX_ROWS_STATE], m, L, step);
        own->targets[k] = allocate(sizeof *own->targets[k] * (size_t)(2 * m + U + 1));
        own->method.sources[k] = (const retrax_index(*)[2])own->sources[k];
        own->method.targets[k] = (const retrax_index(*)[2])own->targets[k];
    }
    const retrax_index apart = L == 1 ? m : L;
    write_places(own->sources[RETRAX_STEP_PUSH] + m + 1, 0, m, apart, 1);
    for (retrax_index i = 0; i < m; i++) {
        own->sources[RETRAX_STEP_PUSH][m + 1 + i][0] += R * L;
    }
    write_places(own->targets[RETRAX_STEP_PREPARE], first[RETRAX_ROWS_FIRST], 2 * m, L, 1);
    write_places(own->targets[RETRAX_STEP_RESIDUAL], first[RETRAX_ROWS_RESIDUAL], m, L, 1);
    write_places(own->targets[RETRAX_STEP_PUSH], 0, m, m * L, 1);
    write_places(own->targets[RETRAX_STEP_END], first[RETRAX_ROWS_NEXT_STATE], m + U + 1, L, 1);
}

/* Builds a method of L lanes and K substeps; `small`: with the inverse Jacobian of small steps. */
static built build(const system_of *system, retrax_index L, retrax_index K, int small) {
    const retrax_index m = system->m, U = system->controls;
    built own = {0};
    own.method.lanes = L;
    own.method.substeps = K;
    own.method.unknowns = own.method.states = m;
    own.method.controls = U;
    const retrax_index first[RETRAX_STEP_ROWS] = {0,         m,         m + 1,     2 * m + 1,    3 * m + 1,
                                                  4 * m + 1, 5 * m + 1, 6 * m + 1, 6 * m + 1 + U};
    memcpy(own.method.first, first, sizeof first);
    own.method.rows = 6 * m + 2 + U;
    own.parts = numbers(K);
    own.inverse = numbers(m * m);
    for (retrax_index k = 0; k < K; k++) {
        own.parts[k] = 1.0 / (double)K;
    }
    for (retrax_index i = 0; i < m * m; i++) {
        own.inverse[i] = i % (m + 1) == 0 ? 1.0 : 0.0;
    }
    own.method.parts = own.parts;
    own.method.small_step_inverse = small ? own.inverse : NULL;
    write_all_places(&own, m, U, L);
    return own;
}

static void release(built *own) {
    for (int k = 0; k < RETRAX_STEP_FUNCTIONS; k++) {
        free(own->sources[k]);
        free(own->targets[k]);
    }
    free(own->parts);
    free(own->inverse);
}

/* Trajectories with what is kept of them. */
typedef struct {
    retrax_integration own;
    double *step_sizes;
} journey;

static journey begin(const retrax_method *method, retrax_index T, const double *starts, const double *step_sizes) {
    const retrax_index m = method->unknowns, K = method->substeps, L = method->lanes, B = (T + L - 1) / L;
    journey found = {{0}, numbers(T)};
    memcpy(found.step_sizes, step_sizes, sizeof(double) * (size_t)T);
    retrax_integration *const own = &found.own;
    own->trajectories = T;
    own->step_sizes = found.step_sizes;
    own->kept = m + K * method->controls;
    own->carry = numbers(own->kept * T);
    memcpy(own->carry, starts, sizeof(double) * (size_t)(m * T));
    own->failed = allocate(sizeof(retrax_index) * (size_t)T); /* all -1 */
    own->inverses = numbers(B * K * m * m * L);
    own->spent = numbers(B * K);
    own->differences = numbers(B * K * RETRAX_ORDERS * m * L);
    memset(own->differences, 0, sizeof(double) * (size_t)(B * K * RETRAX_ORDERS * m * L));
    for (retrax_index i = 0; i < B * K; i++) {
        own->spent[i] = INFINITY;
    }
    own->every = 1;
    return found;
}

static void end(journey *found) {
    free(found->step_sizes);
    free(found->own.carry);
    free(found->own.failed);
    free(found->own.inverses);
    free(found->own.spent);
    free(found->own.differences);
}

/* Whether a step of trajectory t solves its equations. */
static int is_solved(const system_of *system, const retrax_integration *own, const double *before, retrax_index t) {
    const retrax_index m = system->m, T = own->trajectories;
    const double h = own->step_sizes[t];
    double c[LARGEST];
    int solved = 1;
    for (retrax_index i = 0; i < m; i++) {
        c[i] = own->carry[i * T + t];
    }
    for (retrax_index i = 0; i < m; i++) {
        const double was = before[i * T + t], missed = c[i] - was - h * slope_of(system, c, NULL, i);
        /* parts that overflow bound nothing */
        solved = solved && !isnan(missed) && !(fabs(missed) > 1e-9 * parts_of(system, c, was, h, i));
    }
    return solved;
}

/* Makes steps, block by block; returns 0, or the number of a rule that is broken. */
static int advance(built *method, journey *found, const system_of *system, retrax_index steps) {
    retrax_integration *const own = &found->own;
    const retrax_index T = own->trajectories, L = method->method.lanes, count = own->kept * T;
    own->steps = steps;
    own->record = numbers((own->phase + steps + own->every - 1) / own->every * count);
    double *const before = numbers(count);
    memcpy(before, own->carry, sizeof(double) * (size_t)count);
    for (int k = 0; k < RETRAX_STEP_FUNCTIONS; k++) {
        const context_of context = {system, (retrax_step_function)k};
        method->contexts[k] = context;
        method->method.functions[k].evaluate = evaluate;
        method->method.functions[k].context = &method->contexts[k];
    }
    const size_t size = retrax_integration_workspace(&method->method);
    void *const workspace = allocate(size);
    for (retrax_index block = 0; block < (T + L - 1) / L; block++) {
        retrax_integrate(&method->method, own, block, block + 1, workspace);
    }
    int broken = size % 64 != 0;
    for (retrax_index t = 0; t < T; t++) {
        const retrax_index failed = own->failed[t];
        broken = failed < -1 || failed >= own->done + steps ? 2 : broken;
        for (retrax_index i = 0; i < own->kept; i++) {
            const double is = own->carry[i * T + t], was = before[i * T + t];
            const double last = own->record[((own->phase + steps - 1) / own->every * own->kept + i) * T + t];
            broken = memcmp(&is, &last, sizeof is) != 0 ? 3 : broken;
            broken = failed >= 0 && failed <= own->done && memcmp(&is, &was, sizeof is) != 0 ? 4 : broken;
        }
        const int one = steps == 1 && failed < 0 && method->method.substeps == 1;
        broken = !one || is_solved(system, own, before, t) ? broken : 5;
    }
    own->done += steps;
    own->phase = (own->phase + steps) % own->every;
    free(own->record);
    free(before);
    free(workspace);
    return broken;
}

/* A random system; soft ones have steps that are always found. */
static system_of system_drawn(generator *g) {
    system_of found = {{{0}}, 0.0, 0.0, {0}, 1.0, 1 + below(g, LARGEST), 0};
    for (retrax_index i = 0; i < found.m; i++) {
        for (retrax_index j = 0; j < found.m; j++) {
            found.matrix[i][j] = number(g);
        }
        found.sizes[i] = g->hard > 0 ? fabs(number(g)) : 1.0;
    }
    found.cube = number(g) - (g->hard > 0 ? 0.0 : 1.0);
    found.control = number(g);
    found.controls = below(g, found.m);
    found.usable = g->hard > 0 ? (double)below(g, 2) : 1.0;
    return found;
}

/* Integrates one system with one lane after the other, and with many; returns 0, or the rule that is broken. */
static int try_system(generator *g) {
    const system_of system = system_drawn(g);
    const retrax_index m = system.m, T = 1 + below(g, 20), K = 1 + below(g, SUBSTEPS), L = 8 * (1 + below(g, 2));
    double *const starts = numbers(m * T), *const step_sizes = numbers(T);
    for (retrax_index i = 0; i < m * T; i++) {
        starts[i] = number(g);
    }
    for (retrax_index t = 0; t < T; t++) {
        step_sizes[t] = g->hard > 0 ? 4.0 * number(g) : 0.02 + 0.03 * fabs(number(g));
    }
    const int small = (int)below(g, 2);
    built one = build(&system, 1, K, small), many = build(&system, L, K, small);
    journey alone = begin(&one.method, T, starts, step_sizes), beside = begin(&many.method, T, starts, step_sizes);
    alone.own.every = beside.own.every = 1 + below(g, 3);
    int broken = 0;
    for (retrax_index pieces = 1 + below(g, 4); pieces > 0 && !broken; pieces--) {
        const retrax_index steps = 1 + below(g, 3);
        broken = advance(&one, &alone, &system, steps);
        broken = broken ? broken : advance(&many, &beside, &system, steps);
    }
    for (retrax_index t = 0; t < T && g->hard == 0; t++) {
        broken = alone.own.failed[t] >= 0 || beside.own.failed[t] >= 0 ? 6 : broken;
        for (retrax_index i = 0; i < m; i++) {
            const double difference = alone.own.carry[i * T + t] - beside.own.carry[i * T + t];
            broken = fabs(difference) < 1e-12 ? broken : 7;
        }
    }
    end(&alone);
    end(&beside);
    release(&one);
    release(&many);
    free(starts);
    free(step_sizes);
    return broken;
}

int main(int argc, char **argv) {
    if (argc != 3) {
        fprintf(stderr, "usage: fuzz_integrate COUNT SEED\n");
        return 2;
    }
    const long count = atol(argv[1]);
    generator g = {0x9E3779B97F4A7C15u ^ (uint64_t)atol(argv[2]), 0};
    for (long k = 0; k < count; k++) {
        g.hard = k % 2 == 0 ? 0 : (int)(2 + below(&g, 100));
        const int broken = try_system(&g);
        if (broken) {
            fprintf(stderr, "system %ld breaks rule %d\n", k, broken);
            return 1;
        }
    }
    const system_of system = {{{0}}, 0.0, 0.0, {0}, 1.0, 1, 0};
    built huge = build(&system, 8, 1, 0);
    huge.method.rows = PTRDIFF_MAX / 2;
    if (retrax_integration_workspace(&huge.method) != 0) {
        fprintf(stderr, "sizes that do not fit have a workspace\n");
        return 1;
    }
    release(&huge);
    printf("systems that ran: %ld\n", count);
    return 0;
}
