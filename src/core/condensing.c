/*
 * Condensing: the velocities of collocation steps as affine functions of the state and the controls.
 *
 * T and t, the rows of a point or of both ends as functions of w, stand beside each other in one array [T | t], and so do
 * all products with them: a right-hand side is one more column.
 */
#include "dense.h"
#include "layout.h"

#include <string.h>

/* Sizes and workspace of condensing one step. */
typedef struct {
    const retrax_collocation_system *system;
    retrax_instruction_set set;
    const retrax_kernels *kernels; /* for that set */
    retrax_index s, n, m, q, p, z, columns; /* q = 3 n + m, p = s n, z = n + s m */
    retrax_index width;                     /* retrax_width(z + columns) */
    double *velocities; /* [p][width]: M, then nu_0 */
    double *rows;       /* [q][width]: T, then t */
    double *images;     /* [q][width]: -(H T), then -(g + H t) */
    double *condensed;  /* [z][width]: the sum of T' H T, then of T' (g + H t) */
    double *weights;    /* [s] -h times the weights of a point or of the end */
    double *scales;     /* [p] */
    double *place;      /* [q] one column of a point or of both ends */
    double *pulled;     /* [p] slopes by the velocities */
    double *end_slope;  /* [2 n] */
} condensing;

/* Lays out the workspace in a block. */
static void lay_out(condensing *own, retrax_block *block, retrax_index s, retrax_index n, retrax_index m,
                    retrax_index columns) {
    own->s = s;
    own->n = n;
    own->m = m;
    own->columns = columns;
    own->q = 3 * n + m;
    own->p = s * n;
    own->z = n + s * m;
    own->width = retrax_width(own->z + columns);
    own->velocities = retrax_take(block, own->p, own->width, sizeof(double));
    own->rows = retrax_take(block, own->q, own->width, sizeof(double));
    own->images = retrax_take(block, own->q, own->width, sizeof(double));
    own->condensed = retrax_take(block, own->z, own->width, sizeof(double));
    own->weights = retrax_take(block, s, 1, sizeof(double));
    own->scales = retrax_take(block, own->p, 1, sizeof(double));
    own->place = retrax_take(block, own->q, 1, sizeof(double));
    own->pulled = retrax_take(block, own->p, 1, sizeof(double));
    own->end_slope = retrax_take(block, 2 * n, 1, sizeof(double));
}

size_t retrax_condensing_workspace(retrax_index points, retrax_index state_size, retrax_index control_size,
                                   retrax_index columns) {
    const retrax_index most = 1 << 20; /* so that products of two sizes do not overflow */
    if (points < 1 || state_size < 1 || control_size < 0 || columns < 1 || points > most / 1024 ||
        state_size > most / 1024 || control_size > most / 1024 || columns > most / 1024) {
        return 0;
    }
    condensing own = {0};
    retrax_block block = {NULL, 0};
    lay_out(&own, &block, points, state_size, control_size, columns);
    return block.used == SIZE_MAX ? 0 : block.used;
}

static condensing open_workspace(const retrax_collocation_system *system, void *workspace) {
    condensing own = {0};
    retrax_block block = {workspace, 0};
    lay_out(&own, &block, system->points, system->state_size, system->control_size, system->columns);
    own.system = system;
    return own;
}

/* The weights with which the velocities of a step make up a point, or its end. */
static const double *weights_of(const retrax_collocation_system *system, retrax_index point) {
    return point == RETRAX_AT_ENDS ? system->weights : system->matrix + point * system->points;
}

/* ---------------------------------------------------------------------------------------------- condensing */

/* Writes the equations of all points of step k: the matrix of the velocities to `matrix` [p][p], and the right-hand
 * sides, minus the derivatives by w and minus the defects, to own->velocities. */
static void write_equations(condensing *own, retrax_index k, double *matrix) {
    const retrax_collocation_system *const sys = own->system;
    const retrax_index s = own->s, n = own->n, m = own->m, q = own->q, p = own->p;
    memset(matrix, 0, sizeof(double) * (size_t)(p * p));
    memset(own->velocities, 0, sizeof(double) * (size_t)(p * own->width));
    for (retrax_index i = 0; i < s; i++) {
        for (retrax_index a = 0; a < n; a++) {
            const double *const jacobian = sys->jacobian + ((k * s + i) * n + a) * q;
            const double *const defect = sys->defect + ((k * s + i) * n + a) * own->columns;
            double *const row = matrix + (i * n + a) * p, *const side = own->velocities + (i * n + a) * own->width;
            for (retrax_index j = 0; j < s; j++) {
                const double factor = sys->step_size[k] * sys->matrix[i * s + j];
                for (retrax_index b = 0; b < n; b++) {
                    row[j * n + b] = factor * jacobian[n + b];
                }
            }
            for (retrax_index b = 0; b < n; b++) {
                row[i * n + b] += jacobian[2 * n + b];
                side[b] = -jacobian[b];
            }
            for (retrax_index b = 0; b < m; b++) {
                side[n + i * m + b] = -jacobian[3 * n + b];
            }
            for (retrax_index j = 0; j < own->columns; j++) {
                side[own->z + j] = -defect[j];
            }
        }
    }
}

/* Writes [T | t] of a point, (dx, dxi, dnu, du), or of the ends, (dx, deta), of a step of size h. */
static void write_rows(condensing *own, double h, retrax_index point) {
    const retrax_index n = own->n, width = own->width, count = point == RETRAX_AT_ENDS ? 2 * n : own->q;
    const double *const weights = weights_of(own->system, point);
    memset(own->rows, 0, sizeof(double) * (size_t)(count * width));
    for (retrax_index i = 0; i < own->s; i++) {
        own->weights[i] = -h * weights[i];
    }
    for (retrax_index a = 0; a < n; a++) {
        own->rows[a * width + a] = 1.0;
        own->kernels->subtract_products(1, width, own->s, own->rows + (n + a) * width, width, own->weights, 1,
                                        own->velocities + a * width, n * width);
    }
    if (point != RETRAX_AT_ENDS) {
        memcpy(own->rows + 2 * n * width, own->velocities + point * n * width, sizeof(double) * (size_t)(n * width));
        for (retrax_index b = 0; b < own->m; b++) {
            own->rows[(3 * n + b) * width + n + point * own->m + b] = 1.0;
        }
    }
}

/* own->condensed -= a row of own->images, in the row that has a one in T. */
static void subtract_image(condensing *own, retrax_index row, retrax_index image) {
    double *const to = own->condensed + row * own->width;
    const double *const from = own->images + image * own->width;
    for (retrax_index j = 0; j < own->width; j++) {
        to[j] -= from[j];
    }
}

/* Adds T' (H [T | t] + [0 | g]) of a point or of the ends to own->condensed, on and above the diagonal. hessian:
 * [size][size]; slope: [size][columns]. In the rows of dx and du T has nothing but ones. */
static void add_pullback(condensing *own, retrax_index point, const double *hessian, const double *slope) {
    const retrax_index n = own->n, z = own->z, width = own->width;
    const retrax_index size = point == RETRAX_AT_ENDS ? 2 * n : own->q, last = point == RETRAX_AT_ENDS ? 2 * n : 3 * n;
    const retrax_index controls = n + point * own->m;
    for (retrax_index a = 0; a < size; a++) {
        double *const image = own->images + a * width;
        memset(image, 0, sizeof(double) * (size_t)width);
        for (retrax_index c = 0; c < n; c++) {
            image[c] = -hessian[a * size + c];
        }
        for (retrax_index c = last; c < size; c++) {
            image[controls + c - last] = -hessian[a * size + c];
        }
        for (retrax_index j = 0; j < own->columns; j++) {
            image[z + j] = -slope[a * own->columns + j];
        }
    }
    own->kernels->subtract_products(size, width, last - n, own->images, width, hessian + n * size, size,
                                    own->rows + n * width, width);
    for (retrax_index a = 0; a < n; a++) {
        subtract_image(own, a, a);
    }
    for (retrax_index c = last; c < size; c++) {
        subtract_image(own, controls + c - last, c);
    }
    for (retrax_index first = 0; first < z; first += RETRAX_VECTOR) {
        const retrax_index rows = z - first < RETRAX_VECTOR ? z - first : RETRAX_VECTOR;
        own->kernels->subtract_products(rows, width - first, last - n, own->condensed + first * width + first, width,
                                        own->rows + n * width + first, width, own->images + n * width + first, width);
    }
}

/* Writes block [T | t] of the ends: to matrix [n][z] and to columns [n][columns]; block: [n][2 n]. */
static void write_ends(condensing *own, const double *block, double *matrix, double *columns) {
    const retrax_index n = own->n, z = own->z;
    for (retrax_index a = 0; a < n; a++) {
        double *const image = own->images; /* minus the row */
        memset(image, 0, sizeof(double) * (size_t)own->width);
        own->kernels->subtract_products(1, own->width, n, image, own->width, block + a * 2 * n + n, 1,
                                        own->rows + n * own->width, own->width);
        for (retrax_index j = 0; j < z; j++) {
            matrix[a * z + j] = (j < n ? block[a * 2 * n + j] : 0.0) - image[j];
        }
        for (retrax_index j = 0; j < own->columns; j++) {
            columns[a * own->columns + j] = -image[z + j];
        }
    }
}

/* Condenses step k. */
static void condense_step(condensing *own, retrax_condensed_system *to, retrax_index k) {
    const retrax_collocation_system *const sys = own->system;
    const retrax_index s = own->s, n = own->n, q = own->q, p = own->p, z = own->z, width = own->width;
    const retrax_index columns = own->columns, kept = z + columns;
    double *const factors = to->factors + k * p * p;
    write_equations(own, k, factors);
    retrax_lu_factorise(p, factors, to->swaps + k * p, own->scales);
    retrax_lu_solve(p, factors, to->swaps + k * p, width, own->velocities, own->set);
    for (retrax_index i = 0; i < p; i++) {
        memcpy(to->velocities + (k * p + i) * kept, own->velocities + i * width, sizeof(double) * (size_t)kept);
    }
    memset(own->condensed, 0, sizeof(double) * (size_t)(z * width));
    for (retrax_index i = 0; i < s; i++) {
        write_rows(own, sys->step_size[k], i);
        add_pullback(own, i, sys->hessian + (k * s + i) * q * q, sys->slope + (k * s + i) * q * columns);
    }
    write_rows(own, sys->step_size[k], RETRAX_AT_ENDS);
    add_pullback(own, RETRAX_AT_ENDS, sys->end_hessian + k * 4 * n * n, sys->end_slope + k * 2 * n * columns);
    for (retrax_index i = 0; i < z; i++) {
        for (retrax_index j = 0; j < z; j++) {
            const retrax_index row = i < j ? i : j, column = i < j ? j : i;
            to->hessian[(k * z + i) * z + j] = own->condensed[row * width + column];
        }
        for (retrax_index j = 0; j < columns; j++) {
            to->slope[(k * z + i) * columns + j] = own->condensed[i * width + z + j];
        }
    }
    write_ends(own, sys->end_left + k * 2 * n * n, to->left + k * n * z, to->before + k * n * columns);
    write_ends(own, sys->end_right + k * 2 * n * n, to->right + k * n * z, to->after + k * n * columns);
}

void retrax_condense(const retrax_collocation_system *system, retrax_condensed_system *condensed, retrax_index first,
                     retrax_index last, void *workspace, retrax_instruction_set set) {
    condensing own = open_workspace(system, workspace);
    own.set = set;
    own.kernels = retrax_kernels_for(set);
    for (retrax_index k = first; k < last; k++) {
        condense_step(&own, condensed, k);
    }
}

/* ----------------------------------------------------------------------------------------------- expanding */

void retrax_write_place(const retrax_collocation_system *system, retrax_index k, retrax_index point, retrax_index j,
                        const double *step, const double *velocities, double *to) {
    const retrax_index n = system->state_size, m = system->control_size, s = system->points, columns = system->columns;
    const double *const weights = weights_of(system, point);
    const double h = system->step_size[k];
    for (retrax_index a = 0; a < n; a++) {
        to[a] = step[a * columns + j];
        to[n + a] = 0.0;
        for (retrax_index i = 0; i < s; i++) {
            to[n + a] += h * weights[i] * velocities[(i * n + a) * columns + j];
        }
        if (point != RETRAX_AT_ENDS) {
            to[2 * n + a] = velocities[(point * n + a) * columns + j];
        }
    }
    for (retrax_index b = 0; b < m && point != RETRAX_AT_ENDS; b++) {
        to[3 * n + b] = step[(n + point * m + b) * columns + j];
    }
}

/* Row of hessian place + slope, of column j; hessian: [size][size]. */
static double image_of(const condensing *own, const double *hessian, retrax_index size, retrax_index row) {
    double sum = 0.0;
    for (retrax_index c = 0; c < size; c++) {
        sum += hessian[row * size + c] * own->place[c];
    }
    return sum;
}

/* Adds the derivatives by the velocities at a point or at the ends of step k to own->pulled. */
static void add_pulled(condensing *own, retrax_index k, retrax_index point, retrax_index j) {
    const retrax_collocation_system *const sys = own->system;
    const retrax_index n = own->n, q = own->q, s = own->s, size = point == RETRAX_AT_ENDS ? 2 * n : q;
    const double *const hessian =
        point == RETRAX_AT_ENDS ? sys->end_hessian + k * 4 * n * n : sys->hessian + (k * s + point) * q * q;
    const double *const weights = weights_of(own->system, point);
    const double h = sys->step_size[k];
    for (retrax_index a = 0; a < n; a++) {
        const double slope = point == RETRAX_AT_ENDS ? own->end_slope[n + a]
                                           : sys->slope[((k * s + point) * q + n + a) * own->columns + j];
        const double value = slope + image_of(own, hessian, size, n + a);
        for (retrax_index i = 0; i < s; i++) {
            own->pulled[i * n + a] += h * weights[i] * value;
        }
        if (point != RETRAX_AT_ENDS) {
            own->pulled[point * n + a] += sys->slope[((k * s + point) * q + 2 * n + a) * own->columns + j] +
                                          image_of(own, hessian, size, 2 * n + a);
        }
    }
}

/* Writes the slope of the ends by deta, with the multipliers of both nodes, of column j to own->end_slope. */
static void write_end_slope(condensing *own, retrax_index k, retrax_index j, const double *multipliers) {
    const retrax_collocation_system *const sys = own->system;
    const retrax_index n = own->n, columns = own->columns;
    for (retrax_index c = n; c < 2 * n; c++) {
        double sum = sys->end_slope[(k * 2 * n + c) * columns + j];
        for (retrax_index a = 0; a < n; a++) {
            sum += sys->end_left[(k * n + a) * 2 * n + c] * multipliers[(k * n + a) * columns + j];
            sum -= sys->end_right[(k * n + a) * 2 * n + c] * multipliers[((k + 1) * n + a) * columns + j];
        }
        own->end_slope[c] = sum;
    }
}

void retrax_expand(const retrax_collocation_system *system, const retrax_condensed_system *condensed,
                   retrax_index first, retrax_index last, const double *step, const double *multipliers,
                   double *velocities, double *lambdas, void *workspace) {
    condensing own = open_workspace(system, workspace);
    const retrax_index p = own.p, z = own.z, columns = own.columns;
    for (retrax_index k = first; k < last; k++) {
        const double *const own_step = step + k * z * columns;
        double *const own_velocities = velocities + k * p * columns;
        for (retrax_index j = 0; j < columns; j++) {
            for (retrax_index i = 0; i < p; i++) {
                const double *const row = condensed->velocities + (k * p + i) * (z + columns);
                double sum = row[z + j];
                for (retrax_index c = 0; c < z; c++) {
                    sum += row[c] * own_step[c * columns + j];
                }
                own_velocities[i * columns + j] = sum;
                own.pulled[i] = 0.0;
            }
            write_end_slope(&own, k, j, multipliers);
            for (retrax_index point = RETRAX_AT_ENDS; point < own.s; point++) {
                retrax_write_place(system, k, point, j, own_step, own_velocities, own.place);
                add_pulled(&own, k, point, j);
            }
            retrax_lu_solve_transposed(p, condensed->factors + k * p * p, condensed->swaps + k * p, own.pulled);
            for (retrax_index i = 0; i < p; i++) {
                lambdas[(k * p + i) * columns + j] = -own.pulled[i];
            }
        }
    }
}

void retrax_condense_slope(const retrax_collocation_system *system, const retrax_condensed_system *condensed,
                           const double *slope, const double *end_slope, double *inner, double *outer) {
    const retrax_index s = system->points, n = system->state_size, m = system->control_size, q = 3 * n + m;
    const retrax_index p = s * n, z = n + s * m, kept = z + system->columns;
    for (retrax_index k = 0; k < system->steps; k++) {
        const double *const own = slope + k * s * q, *const end = end_slope == NULL ? NULL : end_slope + k * 2 * n;
        const double h = system->step_size[k];
        for (retrax_index a = 0; a < n; a++) {
            outer[k * z + a] = end == NULL ? 0.0 : end[a];
            for (retrax_index i = 0; i < s; i++) {
                outer[k * z + a] += own[i * q + a];
            }
        }
        for (retrax_index i = 0; i < s; i++) {
            memcpy(outer + k * z + n + i * m, own + i * q + 3 * n, sizeof(double) * (size_t)m);
        }
        for (retrax_index i = 0; i < s; i++) {
            for (retrax_index a = 0; a < n; a++) {
                double sum = end == NULL ? 0.0 : h * system->weights[i] * end[n + a];
                for (retrax_index j = 0; j < s; j++) {
                    sum += h * system->matrix[j * s + i] * own[j * q + n + a];
                }
                sum += own[i * q + 2 * n + a];
                inner[k * p + i * n + a] = sum;
                const double *const row = condensed->velocities + (k * p + i * n + a) * kept;
                for (retrax_index b = 0; b < z; b++) {
                    outer[k * z + b] += row[b] * sum;
                }
            }
        }
    }
}
