/*
 * Block elimination of the linear system of a Newton step along a trajectory.
 *
 * The front of stage k has rows d_k (z), c_k (n), rows that stage k - 1 has left, and c_{k+1} (n). All but the last are
 * eliminated, as far as pivots are stable, and leave a Schur complement on the others, which belong to the front of the next
 * stage; at the last stage all are eliminated. A row is left where the leading block of the matrix is singular and the matrix is
 * not, as at a focal point of the trajectory up to a node. Unknowns, equations and cost are in their natural units in the
 * front, and a second scaling makes its rows and columns of one size.
 */
#include "dense.h"

#include <math.h>
#include <stdbool.h>
#include <string.h>

/* Arrays of an elimination. Rows of a front: d from 0, c_k from z, rows that are left from z + n, c_{k+1} behind them, and
 * right-hand sides from front.rows on. */
typedef struct {
    const retrax_block_system *system;
    const retrax_kernels *kernels;
    retrax_index n, z, width; /* width = retrax_width(z + 3 n + columns) */
    retrax_index most;        /* pivots of a stage: z + 2 n */
    retrax_front front;
    double *column_sizes;  /* [2][width] largest entries of columns among the unknowns, and among the equations */
    double *inverse_nodes; /* [n] inverse scaling factors of defects */
    double *carried;       /* [2 n][2 n + columns] what a stage leaves on c_{k+1}, then on the rows that it leaves */
    double *row_scales;    /* [N][width] second scaling of each front */
    double *divided;       /* [N (z + 2 n) + n][width] factors of all stages */
    retrax_index *order;   /* [N (z + 2 n) + n] pivots of all stages, and behind them the rows that are left */
    retrax_index *left;    /* [N + 1] number of rows that the stage before has left */
    double *unknowns;      /* [z + 3 n] of one stage and column, in scaled units */
    double *known;         /* [2 n] of them, those of c_{k+1} and of the rows that are left */
    double *own_step;      /* [z] d of one stage and column */
    double *substituted;   /* [z + 3 n] workspace */
} elimination;

/* Lays out the arrays of an elimination in a block. */
static void lay_out(elimination *own, retrax_block *block, retrax_index stages, retrax_index n, retrax_index z,
                    retrax_index columns) {
    const retrax_index rows = z + 3 * n, width = retrax_width(rows + columns), pivots = stages * (z + 2 * n) + n;
    own->n = n;
    own->z = z;
    own->most = z + 2 * n;
    own->width = width;
    own->front.unknowns = z;
    own->front.columns = columns;
    retrax_take_front(block, rows, width, &own->front);
    own->column_sizes = retrax_take(block, 2, width, sizeof(double));
    own->inverse_nodes = retrax_take(block, n, 1, sizeof(double));
    own->carried = retrax_take(block, 2 * n, 2 * n + columns, sizeof(double));
    own->row_scales = retrax_take(block, stages, width, sizeof(double));
    own->divided = retrax_take(block, pivots, width, sizeof(double));
    own->order = retrax_take(block, pivots, 1, sizeof(retrax_index));
    own->left = retrax_take(block, stages + 1, 1, sizeof(retrax_index));
    own->unknowns = retrax_take(block, rows, 1, sizeof(double));
    own->known = retrax_take(block, 2 * n, 1, sizeof(double));
    own->own_step = retrax_take(block, z, 1, sizeof(double));
    own->substituted = retrax_take(block, rows, 1, sizeof(double));
}

size_t retrax_block_workspace(retrax_index stages, retrax_index node_size, retrax_index stage_size,
                              retrax_index columns) {
    const retrax_index most = PTRDIFF_MAX / 1024; /* so that sums and products of sizes do not overflow */
    if (stages < 1 || node_size < 1 || stage_size < 1 || columns < 1 || node_size > most / 8 || stage_size > most / 8 ||
        columns > most / 8 || stages > most / (stage_size + 3 * node_size)) {
        return 0;
    }
    elimination own = {0};
    retrax_block block = {NULL, 0};
    lay_out(&own, &block, stages, node_size, stage_size, columns);
    return block.used == SIZE_MAX ? 0 : block.used;
}

/* ----------------------------------------------------------------------------------------------- assembling */

static double *row_of(const elimination *own, retrax_index i) { return own->front.matrix + i * own->width; }

static double *carried_row(const elimination *own, retrax_index i) {
    return own->carried + i * (2 * own->n + own->system->columns);
}

/* The factor of equation a of node k: the inverse of its scaling factor, or 0 where it is replaced by c = 0. */
static double equation_scale(const elimination *own, retrax_index k, retrax_index a) {
    double scale = own->inverse_nodes[a];
    if (k == 0) {
        scale *= own->system->fixed_start[a];
    }
    if (k == own->system->stages) {
        scale *= own->system->fixed_end[a];
    }
    return scale;
}

/* The defect of equation a of node k in its units, of right-hand side j. */
static double scaled_defect(const elimination *own, retrax_index k, retrax_index a, retrax_index j) {
    return own->system->defect[(k * own->n + a) * own->system->columns + j] * equation_scale(own, k, a);
}

/* Rows of stage k that are eliminated there or left: all of the last stage. */
static retrax_index pivot_count(const elimination *own, retrax_index k) {
    const retrax_index own_rows = own->z + own->n + own->left[k];
    return k == own->system->stages - 1 ? own_rows + own->n : own_rows;
}

/* Writes what no stage has left on the first node: nothing, or -c = 0 where a coordinate is free. */
static void open_front(elimination *own) {
    own->left[0] = 0;
    memset(own->carried, 0, sizeof(double) * (size_t)(2 * own->n * (2 * own->n + own->system->columns)));
    for (retrax_index a = 0; a < own->n; a++) {
        carried_row(own, a)[a] = own->system->fixed_start[a] - 1.0;
    }
}

/* Writes the rows of c_k and c_{k+1} in the columns of d_k, and the same numbers in the rows of d_k. */
static void write_ends(elimination *own, retrax_index k) {
    const retrax_block_system *const s = own->system;
    const retrax_index n = own->n, z = own->z, last = z + n + own->left[k];
    for (retrax_index a = 0; a < n; a++) {
        const double *const left = s->left + (k * n + a) * z, *const right = s->right + (k * n + a) * z;
        const double near = equation_scale(own, k, a), far = -equation_scale(own, k + 1, a);
        double *const before = row_of(own, z + a), *const after = row_of(own, last + a);
        for (retrax_index i = 0; i < z; i++) {
            before[i] = row_of(own, i)[z + a] = left[i] * (near * s->stage_scale[i]);
            after[i] = row_of(own, i)[last + a] = right[i] * (far * s->stage_scale[i]);
        }
    }
}

/* Writes the rows of d_k. */
static void write_stage(elimination *own, retrax_index k) {
    const retrax_block_system *const s = own->system;
    const retrax_index z = own->z, columns = s->columns;
    for (retrax_index i = 0; i < z; i++) {
        double *const row = row_of(own, i);
        const double *const hessian = s->hessian + (k * z + i) * z, factor = s->stage_scale[i] / s->cost_scale;
        for (retrax_index j = 0; j < z; j++) {
            row[j] = hessian[j] * (factor * s->stage_scale[j]);
        }
        row[i] += s->regularisation * s->regularised[i];
        for (retrax_index j = 0; j < columns; j++) {
            row[own->front.rows + j] = -s->slope[(k * z + i) * columns + j] * (s->stage_scale[i] / s->cost_scale);
        }
    }
}

/* Writes what the stage before has left on c_k and on the rows that it has left. */
static void write_carried(elimination *own, retrax_index k) {
    const retrax_block_system *const s = own->system;
    const retrax_index n = own->n, z = own->z, count = n + own->left[k];
    for (retrax_index a = 0; a < count; a++) {
        double *const row = row_of(own, z + a);
        const double *const carried = carried_row(own, a);
        memcpy(row + z, carried, sizeof(double) * (size_t)count);
        for (retrax_index j = 0; j < s->columns; j++) {
            row[own->front.rows + j] = carried[2 * n + j] - (a < n ? scaled_defect(own, k, a, j) : 0.0);
        }
    }
}

/* Writes what only the rows of the last node have: -c = 0 where a coordinate is free, and the last defect. */
static void close_front(elimination *own) {
    const retrax_block_system *const s = own->system;
    const retrax_index last = own->front.rows - own->n;
    for (retrax_index a = 0; a < own->n; a++) {
        double *const row = row_of(own, last + a);
        row[last + a] = s->fixed_end[a] - 1.0;
        for (retrax_index j = 0; j < s->columns; j++) {
            row[own->front.rows + j] = -scaled_defect(own, s->stages, a, j);
        }
    }
}

/* Writes the front of stage k. */
static void write_front(elimination *own, retrax_index k) {
    own->front.rows = own->z + 2 * own->n + own->left[k];
    memset(own->front.matrix, 0, sizeof(double) * (size_t)(own->front.rows * own->width));
    write_stage(own, k);
    write_ends(own, k);
    write_carried(own, k);
    if (k == own->system->stages - 1) {
        close_front(own);
    }
}

/* Keeps what stage k leaves on c_{k+1} and on the rows that it leaves. */
static void carry(elimination *own, retrax_index k, const retrax_pivots *found) {
    const retrax_index n = own->n, pivots = pivot_count(own, k), left = pivots - found->count;
    own->left[k + 1] = left;
    for (retrax_index a = 0; a < n + left; a++) {
        const retrax_index row = a < n ? pivots + a : found->order[found->count + a - n];
        double *const to = carried_row(own, a);
        for (retrax_index b = 0; b <= a; b++) { /* of rows in the border, columns before it are not kept up */
            const retrax_index column = b < n ? pivots + b : found->order[found->count + b - n];
            to[b] = carried_row(own, b)[a] = row_of(own, row)[column];
        }
        memcpy(to + 2 * n, row_of(own, row) + own->front.rows, sizeof(double) * (size_t)own->system->columns);
    }
}

/* Scales the first `pivots` rows and columns of a front to one size: unknowns by their largest entries, equations by
 * the unknowns in their sizes. Rows that the stage before has left stay as they were scaled there, so that small ones
 * show. */
static void scale_front(elimination *own, retrax_index pivots, double *scales) {
    const retrax_index z = own->z, width = own->width;
    double *const of_unknowns = own->column_sizes, *const of_equations = own->column_sizes + width;
    own->kernels->largest(z, width, of_unknowns, NULL, row_of(own, 0));
    own->kernels->largest(pivots - z, width, of_equations, NULL, row_of(own, z));
    for (retrax_index j = 0; j < z; j++) {
        const double most = of_unknowns[j] > of_equations[j] ? of_unknowns[j] : of_equations[j];
        scales[j] = most > 0.0 ? 1.0 / sqrt(most) : 1.0;
    }
    own->kernels->largest(z, width, of_unknowns, scales, row_of(own, 0));
    for (retrax_index j = z; j < pivots; j++) {
        const double root = sqrt(of_equations[j]), most = of_unknowns[j] > root ? of_unknowns[j] : root;
        const bool left = j >= z + own->n && j < own->front.rows - own->n;
        scales[j] = most > 0.0 && !left ? 1.0 / most : 1.0;
    }
    for (retrax_index j = pivots; j < width; j++) {
        scales[j] = 1.0;
    }
    own->kernels->scale_both(own->front.rows, width, row_of(own, 0), scales, scales);
}

/* Factors of stage k. */
static retrax_pivots pivots_of(const elimination *own, retrax_index k) {
    const retrax_index first = k * own->most, left = k < own->system->stages - 1 ? own->left[k + 1] : 0;
    const retrax_pivots found = {own->divided + first * own->width, own->order + first, pivot_count(own, k) - left};
    return found;
}

/* ------------------------------------------------------------------------------------------------- passes */

/* Factorises stage after stage; returns the inertia of the matrix. */
static retrax_inertia eliminate_forward(elimination *own) {
    const retrax_index stages = own->system->stages;
    retrax_inertia inertia = {0, INFINITY};
    open_front(own);
    for (retrax_index k = 0; k < stages; k++) {
        const bool last = k == stages - 1, alike = k > 0 && own->left[k] == 0 && own->left[k - 1] == 0;
        const retrax_index count = pivot_count(own, k), like = alike ? own->z + own->n : 0;
        write_front(own, k);
        scale_front(own, count, own->row_scales + k * own->width);
        own->left[k + 1] = 0;
        retrax_pivots found = pivots_of(own, k);
        const retrax_index *const guess = alike ? own->order + (k - 1) * own->most : NULL;
        retrax_add_inertia(&inertia, retrax_front_factorise(own->kernels, &own->front, count, last ? 0 : own->n, guess, like,
                                                            &found));
        if (!last) {
            carry(own, k, &found);
        }
    }
    return inertia;
}

/* Row a of a block [n][z] times d of the stage. */
static double times_step(const elimination *own, const double *block, retrax_index a) {
    double sum = 0.0;
    for (retrax_index i = 0; i < own->z; i++) {
        sum += block[a * own->z + i] * own->own_step[i];
    }
    return sum;
}

/* d' H_k d of the stage. */
static double curvature_of(const elimination *own, retrax_index k) {
    double sum = 0.0;
    for (retrax_index i = 0; i < own->z; i++) {
        sum += own->own_step[i] * times_step(own, own->system->hessian + k * own->z * own->z, i);
    }
    return sum;
}

/* Adds the stage to what a solution says of its first column. */
static void summarise(const elimination *own, retrax_index k, retrax_block_solution *solution) {
    solution->curvature += curvature_of(own, k) / own->system->cost_scale;
    for (retrax_index i = 0; i < own->z; i++) {
        const double size = fabs(own->own_step[i]), unknown = own->unknowns[i];
        solution->size += own->system->regularised[i] * unknown * unknown;
        if (!(size <= solution->largest_step[i])) {
            solution->largest_step[i] = size;
        }
    }
}

/* Solves for column j of the right-hand sides from the last stage to the first. */
static void substitute_backward(elimination *own, retrax_index j, retrax_block_solution *solution) {
    const retrax_block_system *const s = own->system;
    const retrax_index n = own->n, z = own->z, columns = s->columns;
    double *const x = own->unknowns;
    for (retrax_index k = s->stages - 1; k >= 0; k--) {
        const retrax_pivots found = pivots_of(own, k);
        const retrax_index count = pivot_count(own, k);
        own->front.rows = z + 2 * n + own->left[k];
        for (retrax_index a = 0; k < s->stages - 1 && a < n + count - found.count; a++) { /* from the stage behind */
            x[a < n ? count + a : found.order[found.count + a - n]] = own->known[a];
        }
        retrax_front_substitute(&own->front, count, &found, j, x, own->substituted);
        for (retrax_index i = 0; i < count; i++) {
            x[i] *= own->row_scales[k * own->width + i];
        }
        for (retrax_index i = 0; i < z; i++) {
            own->own_step[i] = x[i] * s->stage_scale[i];
            solution->step[(k * z + i) * columns + j] = own->own_step[i];
        }
        for (retrax_index a = 0; a < n; a++) {
            const double unit = s->cost_scale * own->inverse_nodes[a];
            solution->multipliers[(k * n + a) * columns + j] = x[z + a] * unit;
            if (k == s->stages - 1) {
                solution->multipliers[((k + 1) * n + a) * columns + j] = x[count - n + a] * unit;
            }
        }
        memcpy(own->known, x + z, sizeof(double) * (size_t)(n + own->left[k]));
        if (j == 0) {
            summarise(own, k, solution);
        }
    }
}

/* Writes NaN to column j if a number of it is not finite; returns whether it was finite. */
static unsigned char keep_finite(const retrax_block_system *s, retrax_index j, retrax_block_solution *solution) {
    const retrax_index steps = s->stages * s->stage_size, multipliers = (s->stages + 1) * s->node_size;
    double sum = 0.0; /* 0, or NaN where a number is not finite */
    for (retrax_index i = 0; i < steps; i++) {
        sum += 0.0 * solution->step[i * s->columns + j];
    }
    for (retrax_index i = 0; i < multipliers; i++) {
        sum += 0.0 * solution->multipliers[i * s->columns + j];
    }
    if (sum == 0.0) {
        return 1;
    }
    for (retrax_index i = 0; i < steps; i++) {
        solution->step[i * s->columns + j] = NAN;
    }
    for (retrax_index i = 0; i < multipliers; i++) {
        solution->multipliers[i * s->columns + j] = NAN;
    }
    return 0;
}

void retrax_block_eliminate(const retrax_block_system *system, retrax_block_solution *solution, void *workspace,
                            retrax_instruction_set set) {
    elimination own = {0};
    retrax_block block = {workspace, 0};
    lay_out(&own, &block, system->stages, system->node_size, system->stage_size, system->columns);
    own.system = system;
    own.kernels = retrax_kernels_for(set);
    for (retrax_index a = 0; a < own.n; a++) {
        own.inverse_nodes[a] = 1.0 / system->node_scale[a];
    }

    solution->inertia = eliminate_forward(&own);
    solution->curvature = 0.0;
    solution->size = 0.0;
    memset(solution->largest_step, 0, sizeof(double) * (size_t)own.z);
    for (retrax_index j = 0; j < system->columns; j++) {
        substitute_backward(&own, j, solution);
        solution->finite[j] = keep_finite(system, j, solution);
    }
    solution->curvature += system->regularisation * solution->size;
    if (!solution->finite[0]) {
        solution->size = NAN;
        for (retrax_index i = 0; i < own.z; i++) {
            solution->largest_step[i] = NAN;
        }
    }
}
