/*
 * Block elimination of the linear system of a Newton step along a trajectory.
 *
 * The front of stage k has rows d_k (z), c_k (n) and c_{k+1} (n). The first two are eliminated and leave a Schur
 * complement on the last, which are the rows c_k of the next stage; at the last stage all are eliminated. Unknowns,
 * equations and cost are in their natural units in the front, and a second scaling makes its rows and columns of one
 * size.
 */
#include "dense.h"
#include "workspace.h"

#include <math.h>
#include <string.h>

/* Weight of the augmented terms, times the number of stages; the curvature of the cost of a stage is about 1. */
#define WEIGHT 256.0

/* Arrays of an elimination. Rows of a front: d from 0, c_k from z, c_{k+1} from z + n, right-hand sides from z + 2 n. */
typedef struct {
    const retrax_block_system *system;
    const retrax_kernels *kernels;
    retrax_index n, z, rows, width; /* rows = z + 2 n, width = retrax_width(rows + columns) */
    double weight;
    retrax_front front;
    double *column_sizes;  /* [2][width] largest entries of columns among the unknowns, and among the equations */
    double *inverse_nodes; /* [n] inverse natural sizes of defects */
    double *defects;       /* [n][columns] of the node before a stage, in units */
    double *weighted;      /* [2 n][width] weight times rows of -L_k and R_k in units, so that products subtract */
    double *row_scales;    /* [N][width] second scaling of each front */
    double *divided;       /* [N (z + n) + n][width] factors of all stages */
    retrax_index *order;   /* [N (z + n) + n] pivots of all stages */
    double *unknowns;      /* [rows] of one stage and column, in scaled units */
    double *own_step;      /* [z] d of one stage and column */
    double *substituted;   /* [rows] workspace */
} elimination;

/* Lays out the arrays of an elimination in a block. */
static void lay_out(elimination *own, retrax_block *block, retrax_index stages, retrax_index n, retrax_index z,
                    retrax_index columns) {
    const retrax_index rows = z + 2 * n, width = retrax_width(rows + columns), pivots = stages * (z + n) + n;
    own->n = n;
    own->z = z;
    own->rows = rows;
    own->width = width;
    own->front.rows = rows;
    own->front.columns = columns;
    own->front.width = width;
    own->front.matrix = retrax_take(block, rows, width, sizeof(double));
    own->front.left = retrax_take(block, 1, width, sizeof(double));
    own->front.sizes = retrax_take(block, 1, width, sizeof(double));
    own->front.kept = retrax_take(block, rows, width, sizeof(double));
    own->front.known = retrax_take(block, rows, 1, sizeof(retrax_index));
    own->column_sizes = retrax_take(block, 2, width, sizeof(double));
    own->inverse_nodes = retrax_take(block, n, 1, sizeof(double));
    own->defects = retrax_take(block, n, columns, sizeof(double));
    own->weighted = retrax_take(block, 2 * n, width, sizeof(double));
    own->row_scales = retrax_take(block, stages, width, sizeof(double));
    own->divided = retrax_take(block, pivots, width, sizeof(double));
    own->order = retrax_take(block, pivots, 1, sizeof(retrax_index));
    own->unknowns = retrax_take(block, rows, 1, sizeof(double));
    own->own_step = retrax_take(block, z, 1, sizeof(double));
    own->substituted = retrax_take(block, rows, 1, sizeof(double));
}

size_t retrax_block_workspace(retrax_index stages, retrax_index node_size, retrax_index stage_size,
                              retrax_index columns) {
    const retrax_index most = PTRDIFF_MAX / 1024; /* so that sums and products of sizes do not overflow */
    if (stages < 1 || node_size < 1 || stage_size < 1 || columns < 1 || node_size > most / 8 || stage_size > most / 8 ||
        columns > most / 8 || stages > most / (stage_size + 2 * node_size)) {
        return 0;
    }
    elimination own = {0};
    retrax_block block = {NULL, 0};
    lay_out(&own, &block, stages, node_size, stage_size, columns);
    return block.used == SIZE_MAX ? 0 : block.used;
}

/* ----------------------------------------------------------------------------------------------- assembling */

static double *row_of(const elimination *own, retrax_index i) { return own->front.matrix + i * own->width; }

/* The factor of equation a of node k: the inverse of its natural size, or 0 where it is replaced by c = 0. */
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

/* Writes what no stage has left on the first node: nothing, or -c = 0 where a coordinate is free. */
static void open_front(elimination *own) {
    for (retrax_index a = 0; a < own->n; a++) {
        double *const row = row_of(own, own->z + own->n + a);
        memset(row, 0, sizeof(double) * (size_t)own->width);
        row[own->z + own->n + a] = own->system->fixed_start[a] - 1.0;
    }
}

/* Writes the rows of c_k, with what the stage before left on the node, and of c_{k+1}; and these times the weight. */
static void write_nodes(elimination *own, retrax_index k) {
    const retrax_block_system *const s = own->system;
    const retrax_index n = own->n, z = own->z, rows = own->rows, last = z + n;
    for (retrax_index a = 0; a < n; a++) {
        double *const row = row_of(own, z + a), *const next = row_of(own, last + a);
        double *const weighted = own->weighted + a * own->width, *const weighted_next = weighted + n * own->width;
        const double *const left = s->left + (k * n + a) * z, *const right = s->right + (k * n + a) * z;
        const double before = equation_scale(own, k, a), after = equation_scale(own, k + 1, a);
        memset(row, 0, sizeof(double) * (size_t)own->width);
        memcpy(row + z, next + last, sizeof(double) * (size_t)n);
        for (retrax_index j = 0; j < s->columns; j++) {
            const double defect = scaled_defect(own, k, a, j);
            own->defects[a * s->columns + j] = defect;
            row[rows + j] = next[rows + j] - defect;
        }
        memset(next, 0, sizeof(double) * (size_t)own->width);
        for (retrax_index j = 0; j < z; j++) {
            row[j] = left[j] * (before * s->stage_scale[j]);
            next[j] = right[j] * (-after * s->stage_scale[j]);
            weighted[j] = own->weight * row[j];
            weighted_next[j] = -own->weight * next[j];
        }
    }
}

/* Writes the rows of d_k: the augmented Hessian H + r S + w (R' R - L' L) and its right-hand sides. */
static void write_stage(elimination *own, retrax_index k) {
    const retrax_block_system *const s = own->system;
    const retrax_index n = own->n, z = own->z, rows = own->rows, width = own->width, columns = s->columns;
    for (retrax_index i = 0; i < z; i++) {
        double *const row = row_of(own, i);
        const double *const hessian = s->hessian + (k * z + i) * z, factor = s->stage_scale[i] / s->cost_scale;
        for (retrax_index j = 0; j < z; j++) {
            row[j] = hessian[j] * (factor * s->stage_scale[j]);
        }
        memset(row + z, 0, sizeof(double) * (size_t)(width - z));
    }
    own->kernels->subtract_products(z, retrax_width(z), 2 * n, own->front.matrix, width, own->weighted, width,
                             row_of(own, z), width);
    for (retrax_index i = 0; i < z; i++) {
        double *const row = row_of(own, i);
        row[i] += s->regularisation * s->regularised[i];
        for (retrax_index a = z; a < rows; a++) {
            row[a] = row_of(own, a)[i];
        }
        for (retrax_index j = 0; j < columns; j++) {
            double sum = 0.0;
            for (retrax_index a = 0; a < n; a++) {
                sum += own->defects[a * columns + j] * own->weighted[a * width + i];
            }
            row[rows + j] = sum - s->slope[(k * z + i) * columns + j] * (s->stage_scale[i] / s->cost_scale);
        }
    }
}

/* Writes what only the rows of the last node have: -c = 0 where a coordinate is free, and the last defect. */
static void close_front(elimination *own) {
    const retrax_block_system *const s = own->system;
    const retrax_index last = own->z + own->n;
    for (retrax_index a = 0; a < own->n; a++) {
        double *const row = row_of(own, last + a);
        row[last + a] = s->fixed_end[a] - 1.0;
        for (retrax_index j = 0; j < s->columns; j++) {
            row[own->rows + j] = -scaled_defect(own, s->stages, a, j);
        }
    }
}

/* Scales the first `pivots` rows and columns of a front to one size: unknowns by their largest entries, equations by
 * the unknowns in their sizes, so that weights in the Hessian do not make equations small. */
static void scale_front(elimination *own, retrax_index pivots, double *scales) {
    const retrax_index z = own->z, width = own->width;
    double *const of_unknowns = own->column_sizes, *const of_equations = own->column_sizes + width;
    memset(of_unknowns, 0, sizeof(double) * (size_t)(2 * width));
    for (retrax_index i = 0; i < pivots; i++) {
        own->kernels->raise(width, i < z ? of_unknowns : of_equations, 1.0, row_of(own, i));
    }
    for (retrax_index j = 0; j < z; j++) {
        const double most = of_unknowns[j] > of_equations[j] ? of_unknowns[j] : of_equations[j];
        scales[j] = most > 0.0 ? 1.0 / sqrt(most) : 1.0;
    }
    memset(of_unknowns, 0, sizeof(double) * (size_t)width);
    for (retrax_index i = 0; i < z; i++) {
        own->kernels->raise(width, of_unknowns, scales[i], row_of(own, i));
    }
    for (retrax_index j = z; j < pivots; j++) {
        const double root = sqrt(of_equations[j]), most = of_unknowns[j] > root ? of_unknowns[j] : root;
        scales[j] = most > 0.0 ? 1.0 / most : 1.0;
    }
    for (retrax_index j = pivots; j < width; j++) {
        scales[j] = 1.0;
    }
    for (retrax_index i = 0; i < own->rows; i++) {
        own->kernels->scale_by(width, row_of(own, i), scales[i], scales);
    }
}

/* Factors of stage k. */
static retrax_pivots pivots_of(const elimination *own, retrax_index k) {
    const retrax_index first = k * (own->z + own->n);
    const retrax_pivots found = {own->divided + first * own->width, own->order + first};
    return found;
}

/* Number of rows that stage k eliminates. */
static retrax_index pivot_count(const elimination *own, retrax_index k) {
    return k == own->system->stages - 1 ? own->rows : own->z + own->n;
}

/* ------------------------------------------------------------------------------------------------- passes */

/* Factorises stage after stage; returns the inertia of the matrix. */
static retrax_inertia eliminate_forward(elimination *own) {
    const retrax_index stages = own->system->stages;
    retrax_inertia inertia = {0, INFINITY};
    open_front(own);
    for (retrax_index k = 0; k < stages; k++) {
        const retrax_index count = pivot_count(own, k), like = k > 0 ? own->z + own->n : 0;
        write_nodes(own, k);
        write_stage(own, k);
        if (k == stages - 1) {
            close_front(own);
        }
        scale_front(own, count, own->row_scales + k * own->width);
        retrax_pivots found = pivots_of(own, k);
        const retrax_inertia stage =
            retrax_front_factorise(own->kernels, &own->front, count, found.order - like, like, &found);
        inertia.negative += stage.negative;
        if (stage.smallest < inertia.smallest || stage.smallest != stage.smallest) {
            inertia.smallest = stage.smallest;
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

/* Solves for column j of the right-hand sides from the last stage to the first. The multipliers lose what the augmented
 * terms add to them. */
static void substitute_backward(elimination *own, retrax_index j, retrax_block_solution *solution) {
    const retrax_block_system *const s = own->system;
    const retrax_index n = own->n, z = own->z, last = z + n, columns = s->columns;
    double *const x = own->unknowns;
    for (retrax_index k = s->stages - 1; k >= 0; k--) {
        const retrax_pivots found = pivots_of(own, k);
        const retrax_index count = pivot_count(own, k);
        memcpy(x + last, x + z, sizeof(double) * (size_t)n); /* c_{k+1}, known from the stage behind */
        retrax_front_substitute(&own->front, count, &found, j, x, own->substituted);
        for (retrax_index i = 0; i < count; i++) {
            x[i] *= own->row_scales[k * own->width + i];
        }
        for (retrax_index i = 0; i < z; i++) {
            own->own_step[i] = x[i] * s->stage_scale[i];
            solution->step[(k * z + i) * columns + j] = own->own_step[i];
        }
        for (retrax_index a = 0; a < n; a++) {
            const double moved = times_step(own, s->right + k * n * z, a) * equation_scale(own, k + 1, a);
            solution->multipliers[((k + 1) * n + a) * columns + j] =
                (x[last + a] - own->weight * moved) * (s->cost_scale * own->inverse_nodes[a]);
        }
        if (j == 0) {
            summarise(own, k, solution);
        }
    }
    for (retrax_index a = 0; a < n; a++) {
        solution->multipliers[a * columns + j] = x[z + a] * (s->cost_scale * own->inverse_nodes[a]);
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
    own.weight = WEIGHT * (double)system->stages;
    for (retrax_index a = 0; a < own.n; a++) {
        own.inverse_nodes[a] = 1.0 / system->node_scale[a];
    }
    memset(own.weighted, 0, sizeof(double) * (size_t)(2 * own.n * own.width));

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
