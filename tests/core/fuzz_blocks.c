/*
 * Solves random linear systems of trajectories and LU systems, and condenses steps, in arrays of exactly their size: for
 * the sanitizers and valgrind.
 *
 * usage: fuzz_blocks COUNT SEED
 *
 * Of each system either all numbers of a column are finite, or the column is NaN and says so; a finite column
 * of numbers that are not hard solves a system next to the one given.
 */
#define _POSIX_C_SOURCE 200112L /* posix_memalign */
#include "fuzz.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* Largest backward error of a solution: some eps beside the smallest pivot that is stable, a thousandth of its rows. */
#define BACKWARD 1e-12

static void *allocate(size_t size) {
    void *found = NULL;
    if (posix_memalign(&found, 64, size > 0 ? size : 64) != 0) {
        abort();
    }
    return found;
}

static double *numbers(generator *g, retrax_index count) {
    double *const found = allocate(sizeof(double) * (size_t)count);
    for (retrax_index i = 0; i < count; i++) {
        found[i] = number(g);
    }
    return found;
}

/* Numbers that are 1, or with `other` also 0. */
static double *ones(generator *g, retrax_index count, int other) {
    double *const found = allocate(sizeof(double) * (size_t)count);
    for (retrax_index i = 0; i < count; i++) {
        found[i] = other && below(g, 4) == 0 ? 0.0 : 1.0;
    }
    return found;
}

/* Largest residual, sum of the sizes of a row, solution and right-hand side of a system. */
typedef struct {
    double residual, row, solution, side;
} sizes;

static void raise_to(double *most, double size) { *most = size > *most || isnan(size) ? size : *most; }

/* Adds one term of a row times an unknown to a residual, and its size to the sum of the row. */
static void add_term(double entry, double unknown, double *residual, double *row, sizes *found) {
    *residual += entry * unknown;
    *row += fabs(entry);
    raise_to(&found->solution, fabs(unknown));
}

/* Measures row i of stage k of column j. */
static void measure_stage(const retrax_block_system *s, const retrax_block_solution *x, retrax_index j, retrax_index k,
                          retrax_index i, sizes *found) {
    const retrax_index n = s->node_size, z = s->stage_size, m = s->columns, N = s->stages;
    double residual = s->slope[(k * z + i) * m + j], row = 0.0;
    raise_to(&found->side, fabs(residual));
    for (retrax_index l = 0; l < z; l++) {
        add_term(s->hessian[(k * z + i) * z + l], x->step[(k * z + l) * m + j], &residual, &row, found);
    }
    for (retrax_index a = 0; a < n; a++) {
        const double start = k == 0 ? s->fixed_start[a] : 1.0, end = k == N - 1 ? s->fixed_end[a] : 1.0;
        const double left = start * s->left[(k * n + a) * z + i], right = end * s->right[(k * n + a) * z + i];
        add_term(left, x->multipliers[(k * n + a) * m + j], &residual, &row, found);
        add_term(-right, x->multipliers[((k + 1) * n + a) * m + j], &residual, &row, found);
    }
    raise_to(&found->residual, fabs(residual));
    raise_to(&found->row, row);
}

/* Measures equation a of node k of column j: a multiplier of zero where a coordinate is free. */
static void measure_node(const retrax_block_system *s, const retrax_block_solution *x, retrax_index j, retrax_index k,
                         retrax_index a, sizes *found) {
    const retrax_index n = s->node_size, z = s->stage_size, m = s->columns, N = s->stages;
    const double fixed = k == 0 ? s->fixed_start[a] : (k == N ? s->fixed_end[a] : 1.0);
    double residual = fixed * s->defect[(k * n + a) * m + j], row = 0.0;
    raise_to(&found->side, fabs(residual));
    add_term(fixed - 1.0, x->multipliers[(k * n + a) * m + j], &residual, &row, found);
    for (retrax_index i = 0; i < z && k < N; i++) {
        add_term(fixed * s->left[(k * n + a) * z + i], x->step[(k * z + i) * m + j], &residual, &row, found);
    }
    for (retrax_index i = 0; i < z && k > 0; i++) {
        add_term(-fixed * s->right[((k - 1) * n + a) * z + i], x->step[((k - 1) * z + i) * m + j], &residual, &row, found);
    }
    raise_to(&found->residual, fabs(residual));
    raise_to(&found->row, row);
}

/* Backward error of column j: the least change of matrix and right-hand side, relative to their largest row and entry,
 * with which the solution is exact [Rigal, Gaches, J. ACM 14, 1967]. */
static double backward_error(const retrax_block_system *s, const retrax_block_solution *x, retrax_index j) {
    sizes found = {0.0, 0.0, 0.0, 0.0};
    for (retrax_index k = 0; k <= s->stages; k++) {
        for (retrax_index i = 0; i < s->stage_size && k < s->stages; i++) {
            measure_stage(s, x, j, k, i, &found);
        }
        for (retrax_index a = 0; a < s->node_size; a++) {
            measure_node(s, x, j, k, a, &found);
        }
    }
    return found.residual > 0.0 ? found.residual / (found.row * found.solution + found.side) : found.residual;
}

/* Whether all numbers of column j are finite (1), all are NaN (0), or neither (-1). */
static int kind_of(const retrax_block_system *s, const retrax_block_solution *x, retrax_index j) {
    retrax_index finite = 0, nan = 0, count = 0;
    for (retrax_index i = 0; i < s->stages * s->stage_size; i++, count++) {
        finite += isfinite(x->step[i * s->columns + j]) != 0;
        nan += isnan(x->step[i * s->columns + j]) != 0;
    }
    for (retrax_index i = 0; i < (s->stages + 1) * s->node_size; i++, count++) {
        finite += isfinite(x->multipliers[i * s->columns + j]) != 0;
        nan += isnan(x->multipliers[i * s->columns + j]) != 0;
    }
    return finite == count ? 1 : (nan == count ? 0 : -1);
}

/* Solves one system with each instruction set; returns 0, or the number of a rule that is broken. */
static int try_blocks(generator *g) {
    const retrax_index n = 1 + below(g, 6), z = 1 + below(g, 12), stages = 1 + below(g, 7), columns = 1 + below(g, 3);
    double *const hessian = numbers(g, stages * z * z), *const left = numbers(g, stages * n * z);
    double *const right = numbers(g, stages * n * z), *const slope = numbers(g, stages * z * columns);
    double *const defect = numbers(g, (stages + 1) * n * columns);
    double *const start = ones(g, n, 1), *const end = ones(g, n, 1);
    double *const stage_scale = ones(g, z, 0), *const node_scale = ones(g, n, 0), *const regularised = ones(g, z, 0);
    for (retrax_index k = 0; k < stages; k++) {
        for (retrax_index i = 0; i < z; i++) {
            for (retrax_index j = 0; j < i; j++) {
                hessian[(k * z + i) * z + j] = hessian[(k * z + j) * z + i];
            }
            hessian[(k * z + i) * z + i] += g->hard == 0 ? (double)z : 0.0;
        }
    }
    /* In every other system a stage is flat, perhaps but for rounding: its rows are left to the stage behind. */
    const retrax_index flat = below(g, 2) == 0 ? below(g, stages) : stages;
    const double curvature = below(g, 2) == 0 ? 0.0 : 1e-14;
    for (retrax_index i = 0; i < z * z && flat < stages; i++) {
        hessian[flat * z * z + i] *= curvature;
    }
    const retrax_block_system system = {stages, n,   z,           columns,    hessian, left, right,       slope,
                                        defect, start, end, stage_scale, node_scale, 1.0,     0.0,  regularised};
    const size_t size = retrax_block_workspace(stages, n, z, columns);
    void *const workspace = allocate(size);
    unsigned char *const finite = allocate((size_t)columns);
    retrax_block_solution solution = {0};
    solution.step = allocate(sizeof(double) * (size_t)(stages * z * columns));
    solution.multipliers = allocate(sizeof(double) * (size_t)((stages + 1) * n * columns));
    solution.finite = finite;
    solution.largest_step = allocate(sizeof(double) * (size_t)z);

    int broken = size % 64 != 0;
    for (int set = 0; set <= (int)retrax_best_instruction_set() && !broken; set++) {
        if (below(g, 2) == 0) {
            memset(workspace, 0xff, size); /* NaN: nothing may depend on what was there */
        }
        retrax_block_eliminate(&system, &solution, workspace, (retrax_instruction_set)set);
        const retrax_index unknowns = stages * z + (stages + 1) * n;
        if (solution.inertia.negative < 0 || solution.inertia.negative > unknowns) {
            broken = 2;
        }
        for (retrax_index j = 0; j < columns; j++) {
            if (kind_of(&system, &solution, j) != finite[j]) {
                broken = 3;
            }
            /* Exact for a system that is next to this one, however close to singular both are. */
            if (g->hard == 0 && finite[j] && !(backward_error(&system, &solution, j) < BACKWARD)) {
                broken = 4;
            }
        }
        if (isnan(solution.size) != !finite[0] || isnan(solution.largest_step[0]) != !finite[0]) {
            broken = 5;
        }
    }
    free(hessian);
    free(left);
    free(right);
    free(slope);
    free(defect);
    free(start);
    free(end);
    free(stage_scale);
    free(node_scale);
    free(regularised);
    free(workspace);
    free(finite);
    free(solution.step);
    free(solution.multipliers);
    free(solution.largest_step);
    return broken;
}

/* Factorises and solves one matrix; returns 0, or the number of a rule that is broken. */
static int try_lu(generator *g) {
    const retrax_index n = 1 + below(g, 12), columns = 8 * (1 + below(g, 2));
    double *const matrix = numbers(g, n * n), *const factors = allocate(sizeof(double) * (size_t)(n * n));
    double *const side = numbers(g, n * columns), *const x = allocate(sizeof(double) * (size_t)(n * columns));
    double *const y = numbers(g, n), *const weights = numbers(g, n);
    retrax_index *const swaps = allocate(sizeof(retrax_index) * (size_t)n);
    for (retrax_index i = 0; i < n && g->hard == 0; i++) {
        matrix[i * n + i] += 2.0 * (double)n; /* dominates its row */
    }
    memcpy(factors, matrix, sizeof(double) * (size_t)(n * n));
    memcpy(x, side, sizeof(double) * (size_t)(n * columns));
    retrax_lu_factorise(n, factors, swaps, weights);
    int broken = 0;
    for (retrax_index k = 0; k < n; k++) {
        broken = swaps[k] < k || swaps[k] >= n ? 6 : broken;
    }
    retrax_lu_solve(n, factors, swaps, columns, x, retrax_best_instruction_set());
    retrax_lu_solve_transposed(n, factors, swaps, y);
    for (retrax_index i = 0; i < n && g->hard == 0; i++) {
        for (retrax_index j = 0; j < columns; j++) {
            double sum = side[i * columns + j];
            for (retrax_index k = 0; k < n; k++) {
                sum -= matrix[i * n + k] * x[k * columns + j];
            }
            broken = fabs(sum) < 1e-12 ? broken : 7;
        }
    }
    free(matrix);
    free(factors);
    free(side);
    free(x);
    free(y);
    free(weights);
    free(swaps);
    return broken;
}

/* Condenses and expands steps; returns 0, or the number of a rule that is broken. */
static int try_condensing(generator *g) {
    const retrax_index steps = 1 + below(g, 3), s = 1 + below(g, 3), n = 1 + below(g, 4), m = below(g, 4);
    const retrax_index columns = 1 + below(g, 2), q = 3 * n + m, p = s * n, z = n + s * m;
    double *given[] = {
        numbers(g, steps),
        numbers(g, s * s),
        numbers(g, s),
        numbers(g, steps * s * q * q),
        numbers(g, steps * s * n * q),
        numbers(g, steps * s * q * columns),
        numbers(g, steps * s * n * columns),
        numbers(g, steps * 4 * n * n),
        numbers(g, steps * 2 * n * n),
        numbers(g, steps * 2 * n * n),
        numbers(g, steps * 2 * n * columns),
    };
    double *found[] = {
        numbers(g, steps * z * z),       numbers(g, steps * n * z),       numbers(g, steps * n * z),
        numbers(g, steps * z * columns), numbers(g, steps * n * columns), numbers(g, steps * n * columns),
        numbers(g, steps * p * p),       numbers(g, steps * p * (z + columns)),
    };
    retrax_index *const swaps = allocate(sizeof(retrax_index) * (size_t)(steps * p));
    for (retrax_index k = 0; k < steps * p; k++) {
        swaps[k] = 0;
    }
    const retrax_collocation_system system = {steps,    s,        n,        m,        columns,  given[0], given[1], given[2],
                                              given[3], given[4], given[5], given[6], given[7], given[8], given[9], given[10]};
    retrax_condensed_system condensed = {found[0], found[1], found[2], found[3], found[4],
                                         found[5], found[6], swaps,    found[7]};
    double *const step = numbers(g, steps * z * columns), *const multipliers = numbers(g, (steps + 1) * n * columns);
    double *const velocities = numbers(g, steps * p * columns), *const lambdas = numbers(g, steps * p * columns);
    double *const slope = numbers(g, steps * s * q), *const end_slope = numbers(g, steps * 2 * n);
    double *const inner = numbers(g, steps * p), *const outer = numbers(g, steps * z);
    void *const workspace = allocate(retrax_condensing_workspace(s, n, m, columns));

    for (int set = 0; set <= (int)retrax_best_instruction_set(); set++) {
        retrax_condense(&system, &condensed, 0, steps, workspace, (retrax_instruction_set)set);
    }
    retrax_expand(&system, &condensed, 0, steps, step, multipliers, velocities, lambdas, workspace);
    retrax_condense_slope(&system, &condensed, slope, below(g, 2) == 0 ? NULL : end_slope, inner, outer);
    int broken = 0;
    for (retrax_index k = 0; k < steps * p; k++) {
        broken = swaps[k] < k % p || swaps[k] >= p ? 8 : broken;
    }
    for (size_t k = 0; k < sizeof given / sizeof *given; k++) {
        free(given[k]);
    }
    for (size_t k = 0; k < sizeof found / sizeof *found; k++) {
        free(found[k]);
    }
    free(swaps);
    free(step);
    free(multipliers);
    free(velocities);
    free(lambdas);
    free(slope);
    free(end_slope);
    free(inner);
    free(outer);
    free(workspace);
    return broken;
}

int main(int argc, char **argv) {
    if (argc != 3) {
        fprintf(stderr, "usage: fuzz_blocks COUNT SEED\n");
        return 2;
    }
    const long count = atol(argv[1]);
    generator g = {0x9E3779B97F4A7C15u ^ (uint64_t)atol(argv[2]), 0};
    for (long k = 0; k < count; k++) {
        g.hard = k % 2 == 0 ? 0 : (int)(2 + below(&g, 100));
        const int broken = k % 6 < 2 ? try_blocks(&g) : (k % 6 < 4 ? try_lu(&g) : try_condensing(&g));
        if (broken) {
            fprintf(stderr, "system %ld breaks rule %d\n", k, broken);
            return 1;
        }
    }
    if (retrax_block_workspace(0, 1, 1, 1) != 0 || retrax_block_workspace(PTRDIFF_MAX, 3, 3, 1) != 0 ||
        retrax_block_workspace(10, PTRDIFF_MAX / 2, 3, 1) != 0 || retrax_block_workspace(10, 3, 3, PTRDIFF_MAX) != 0) {
        fprintf(stderr, "sizes that do not fit have a workspace\n");
        return 1;
    }
    printf("systems that ran: %ld\n", count);
    return 0;
}
