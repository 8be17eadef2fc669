/*
 * Scaling: scaling factors of a trajectory from what its controls reach.
 */
#include "dense.h"
#include "layout.h"
#include "workspace.h"

#include <math.h>
#include <string.h>

/* Share of what changes the cost by as much as all others do: a size is no less
 * [test_an_upright_pendulum_that_is_not_linear]. */
#define MATTERS 1e-3
/* Times as far in twice the time, controls move a coordinate without bound: no chain of six integrators comes as far. */
#define EXPLODES 64.0

/* Sizes and workspace of a measurement. */
typedef struct {
    const retrax_layout *layout;
    const double *trajectory;
    const retrax_scale_data *data;
    const retrax_kernels *kernels;
    retrax_instruction_set set;
    retrax_index N, n, z, width; /* width = retrax_width(n) */
    double *near;       /* [n][n] the states' part of the near ends of a step, then its LU factors */
    double *weights;    /* [n] */
    retrax_index *swaps; /* [n] */
    double *inverse[2]; /* [n][width] minus the inverse of that; minus the sizes of its entries */
    double *pushed;     /* [n][z - n] minus the sizes of the controls' part of the near ends */
    double *far[2];     /* [z][width] the far ends of a step, transposed; the sizes of their entries */
    double *terms[2];   /* [z][width]: A', then B', of a step; and the sizes of the terms of these sums */
    double *gramian[2]; /* [n][width] of the linearised steps, and of the sizes of their terms */
    double *image;      /* [z][width] */
    double *drift;      /* [n] of a trajectory that lacks what the nodes lack */
    double *drifted;    /* [n] */
    double *farthest;   /* [n] the most that it has drifted by */
    double *gains;      /* [n][n] the least that a step moves one coordinate by per unit of another */
    double *gramians;   /* [4][N][n] diagonals: from the start, the sizes of its terms, from the end, the sizes */
    double *curvature, *slope; /* [z] sums over all steps of the sizes of the cost's derivatives */
    double *push;       /* [z] sizes of controls of a trajectory of size one */
    double *reach;      /* [z] what such a trajectory moves */
    double *variance;   /* [z - n] diagonal of W */
} scaling;

static void lay_out(scaling *own, retrax_block *block, retrax_index N, retrax_index n, retrax_index z) {
    own->N = N;
    own->n = n;
    own->z = z;
    own->width = retrax_width(n);
    own->near = retrax_take(block, n, n, sizeof(double));
    own->weights = retrax_take(block, n, 1, sizeof(double));
    own->swaps = retrax_take(block, n, 1, sizeof(retrax_index));
    own->pushed = retrax_take(block, n, z, sizeof(double));
    for (int t = 0; t < 2; t++) {
        own->inverse[t] = retrax_take(block, n, own->width, sizeof(double));
        own->far[t] = retrax_take(block, z, own->width, sizeof(double));
        own->terms[t] = retrax_take(block, z, own->width, sizeof(double));
        own->gramian[t] = retrax_take(block, n, own->width, sizeof(double));
    }
    own->image = retrax_take(block, z, own->width, sizeof(double));
    own->drift = retrax_take(block, n, 1, sizeof(double));
    own->drifted = retrax_take(block, n, 1, sizeof(double));
    own->farthest = retrax_take(block, n, 1, sizeof(double));
    own->gains = retrax_take(block, n, n, sizeof(double));
    own->gramians = retrax_take(block, 4 * N, n, sizeof(double));
    own->curvature = retrax_take(block, z, 1, sizeof(double));
    own->slope = retrax_take(block, z, 1, sizeof(double));
    own->push = retrax_take(block, z, 1, sizeof(double));
    own->reach = retrax_take(block, z, 1, sizeof(double));
    own->variance = retrax_take(block, z, 1, sizeof(double));
}

size_t retrax_scaling_workspace(const retrax_problem *problem) {
    scaling own = {0};
    retrax_block block = {NULL, 0};
    const retrax_index n = problem->state_size;
    lay_out(&own, &block, problem->steps, n, n + problem->points * problem->control_size);
    return block.used == SIZE_MAX ? 0 : block.used;
}

static double or_one(double size) { return size > 0.0 && isfinite(size) ? size : 1.0; }

/* ------------------------------------------------------------------------------------------------- linearised steps */

/* to[i][j] = - sum_s f[s][i] x[s][j] for i < rows, s < terms; rows of f are f_width numbers apart, the others width. */
static void multiply(const scaling *own, retrax_index rows, retrax_index terms, double *to, const double *f,
                     retrax_index f_width, const double *x) {
    memset(to, 0, sizeof(double) * (size_t)(rows * own->width));
    own->kernels->subtract_products(rows, own->width, terms, to, own->width, f, f_width, x, own->width);
}

/* Writes minus the inverse of the states' part of the near ends of a step, `near` [n][z], and minus the sizes. */
static void invert(scaling *own, const double *near) {
    const retrax_index n = own->n, m = own->z - n, width = own->width;
    memset(own->inverse[0], 0, sizeof(double) * (size_t)(n * width));
    for (retrax_index a = 0; a < n; a++) {
        memcpy(own->near + a * n, near + a * own->z, sizeof(double) * (size_t)n);
        own->inverse[0][a * width + a] = -1.0;
        for (retrax_index i = 0; i < m; i++) {
            own->pushed[a * m + i] = -fabs(near[a * own->z + n + i]);
        }
    }
    retrax_lu_factorise(n, own->near, own->swaps, own->weights);
    retrax_lu_solve(n, own->near, own->swaps, width, own->inverse[0], own->set);
    for (retrax_index i = 0; i < n * width; i++) {
        own->inverse[1][i] = -fabs(own->inverse[0][i]);
    }
}

/* Writes A' = (far_x near_x^-1)' and B' = (far_u - A near_u)' of a step, and the sizes of the terms of these sums. */
static void write_terms(scaling *own, const double *near, const double *far) {
    const retrax_index n = own->n, z = own->z, m = z - n, width = own->width;
    for (retrax_index j = 0; j < n; j++) {
        for (retrax_index i = 0; i < z; i++) {
            own->far[0][i * width + j] = far[j * z + i];
            own->far[1][i * width + j] = fabs(far[j * z + i]);
        }
    }
    for (int t = 0; t < 2; t++) {
        double *const of_controls = own->terms[t] + n * width;
        multiply(own, n, n, own->terms[t], own->inverse[t], width, own->far[t]);
        memcpy(of_controls, own->far[t] + n * width, sizeof(double) * (size_t)(m * width));
        own->kernels->subtract_products(m, width, n, of_controls, width, t == 0 ? near + n : own->pushed, t == 0 ? z : m,
                                        own->terms[t], width);
    }
}

/* g = A g A' + B W B' in place; terms: A', then B'. */
static void advance_gramian(const scaling *own, const double *terms, double *g) {
    const retrax_index n = own->n, width = own->width;
    multiply(own, n, n, own->image, g, width, terms); /* g is symmetric */
    for (retrax_index i = n; i < own->z; i++) {
        own->kernels->scale(width, own->image + i * width, -own->variance[i - n], terms + i * width);
    }
    multiply(own, n, own->z, g, own->image, width, terms);
}

/* Advances what a trajectory has drifted by to the next node, where it lacks sign * gap. */
static void advance_drift(scaling *own, const double *gap, double sign) {
    const retrax_index n = own->n;
    for (retrax_index a = 0; a < n; a++) {
        own->drifted[a] = sign * gap[a];
        for (retrax_index c = 0; c < n; c++) {
            own->drifted[a] += own->terms[0][c * own->width + a] * own->drift[c];
        }
    }
    for (retrax_index a = 0; a < n; a++) {
        own->drift[a] = own->drifted[a];
        own->farthest[a] = retrax_larger(own->farthest[a], fabs(own->drift[a]));
    }
}

/* The size of a trajectory whose controls make up for what its drift misses of an end; last: the Gramians there. */
static double missed(const scaling *own, const double *fixed, const double *last, const double *last_sizes) {
    double asked = 0.0;
    for (retrax_index a = 0; a < own->n; a++) {
        const double miss = fabs(own->drift[a]), reach = sqrt(fmax(last[a], 0.0));
        const bool told = miss > RETRAX_STILL * retrax_larger(own->data->values[a], own->farthest[a]) &&
                          reach > RETRAX_ROOT_EPS * sqrt(fmax(last_sizes[a], 0.0));
        if (fixed[a] > 0.0 && told && isfinite(miss / reach)) {
            asked = fmax(asked, miss / reach);
        }
    }
    return asked;
}

/* Walks along the steps from the start, or from the end, and writes the diagonals of the Gramians at the far ends;
 * returns the size of a trajectory that makes up for what its drift misses of the other end. */
static double walk(scaling *own, bool from_end) {
    const retrax_layout *const layout = own->layout;
    const double *const trajectory = own->trajectory, *const fixed = ARRAY(FIXED);
    const retrax_index N = own->N, n = own->n, z = own->z;
    const double sign = from_end ? 1.0 : -1.0, *const first = ARRAY(NEWTON_DEFECTS) + (from_end ? N * n : 0);
    const double *const near_fixed = from_end ? fixed + N * n : fixed, *const far_fixed = from_end ? fixed : fixed + N * n;
    double *const diagonals = own->gramians + (from_end ? 2 * N * n : 0);
    memset(own->gramian[0], 0, sizeof(double) * (size_t)(n * own->width));
    memset(own->gramian[1], 0, sizeof(double) * (size_t)(n * own->width));
    for (retrax_index a = 0; a < n; a++) {
        own->drift[a] = sign * first[a] * near_fixed[a];
        own->farthest[a] = 0.0;
    }
    for (retrax_index i = 0; i < N; i++) {
        const retrax_index k = from_end ? N - 1 - i : i, node = from_end ? k : k + 1;
        const double *const left = ARRAY(LEFT) + k * n * z, *const right = ARRAY(RIGHT) + k * n * z;
        const double *const near = from_end ? right : left, *const far = from_end ? left : right;
        invert(own, near);
        write_terms(own, near, far);
        advance_drift(own, ARRAY(NEWTON_DEFECTS) + node * n, sign);
        for (retrax_index a = 0; a < n && !from_end; a++) {
            for (retrax_index c = 0; c < n; c++) {
                own->gains[a * n + c] = fmin(own->gains[a * n + c], fabs(own->terms[0][c * own->width + a]));
            }
        }
        for (int t = 0; t < 2; t++) {
            advance_gramian(own, own->terms[t], own->gramian[t]);
            for (retrax_index a = 0; a < n; a++) {
                diagonals[(t * N + k) * n + a] = own->gramian[t][a * own->width + a];
            }
        }
    }
    const double *const last = diagonals + (from_end ? 0 : (N - 1) * n);
    return missed(own, far_fixed, last, last + N * n);
}

/* How far controls move a coordinate of a node between two fixed ends; one step has no node between its ends. `sizes`:
 * 1 for the sizes of the terms. */
static double reached(const scaling *own, retrax_index a, int sizes) {
    const retrax_index N = own->N, n = own->n;
    const double *const ahead = own->gramians + sizes * N * n, *const back = ahead + 2 * N * n;
    double largest = -INFINITY;
    for (retrax_index k = 0; k < (N == 1 ? 1 : N - 1); k++) {
        const double before = ahead[k * n + a], after = N == 1 ? before : back[(k + 1) * n + a];
        largest = retrax_larger(largest, after < before || isnan(after) ? after : before);
    }
    return isfinite(largest) ? sqrt(fmax(largest, 0.0)) : 0.0;
}

/* Whether controls move a coordinate much farther in half of the time than in a quarter of it
 * [test_a_pendulum_is_held_upright]. */
static bool explodes(const scaling *own, retrax_index a) {
    const retrax_index N = own->N, n = own->n, whole = N / 2, half = N / 4;
    if (half < 1) {
        return false;
    }
    const double *const ahead = own->gramians, *const back = ahead + 2 * N * n;
    const double far = fmin(ahead[(whole - 1) * n + a], back[whole * n + a]);
    const double near = fmin(ahead[(half - 1) * n + a], back[(N - half) * n + a]);
    return far > EXPLODES * EXPLODES * near;
}

/* ------------------------------------------------------------------------------------------------------------ sizes */

/* Writes the sums of the sizes of curvatures and slopes of the cost over the steps. */
static void sum_costs(scaling *own) {
    const retrax_layout *const layout = own->layout;
    const double *const trajectory = own->trajectory;
    const retrax_index z = own->z;
    for (retrax_index i = 0; i < z; i++) {
        own->curvature[i] = own->slope[i] = 0.0;
        for (retrax_index k = 0; k < own->N; k++) {
            own->curvature[i] += fabs(ARRAY(HESSIANS)[(k * z + i) * z + i]);
            own->slope[i] += fabs(ARRAY(GRADIENTS)[k * z + i]);
        }
    }
}

/* Writes what controls of a trajectory of size one are, by the curvature of the cost or by the room that they have. */
static void write_push(scaling *own, bool convex) {
    const retrax_index n = own->n, z = own->z;
    double widest = 0.0;
    for (retrax_index i = n; i < z; i++) {
        widest = retrax_larger(widest, convex ? own->data->room[i - n] * sqrt(own->curvature[i]) : INFINITY);
    }
    for (retrax_index i = n; i < z; i++) {
        const double room = own->data->room[i - n];
        own->push[i] = convex ? 1.0 / sqrt(own->curvature[i]) : own->data->sizes[i];
        if (room > 0.0 && widest > 0.0 && isfinite(widest)) {
            own->push[i] = room / widest;
        }
        own->reach[i] = own->push[i];
        own->variance[i - n] = (double)own->N * own->push[i] * own->push[i];
    }
}

/* The size of the trajectory: what its ends (`asked`), its controls and the slope of the cost ask for, within its room.
 * It moves one of its coordinates as far as the guess does; where all else asks for rounding, one that the guess moves,
 * if that costs no more than the guess. */
static double size_of(const scaling *own, double asked, bool convex) {
    const retrax_index n = own->n;
    double least = INFINITY, any_least = INFINITY, most = 0.0, costs = 0.0;
    for (retrax_index i = 0; i < own->z; i++) {
        const double size = own->data->sizes[i], reach = own->reach[i];
        const double curvature = own->curvature[i], slope = own->slope[i];
        if (reach > 0.0) {
            const double ratio = size / reach;
            asked = retrax_larger(asked, i >= n ? ratio : 0.0);
            least = fmin(least, i < n ? ratio : INFINITY);
            any_least = fmin(any_least, ratio > 0.0 && i < n ? ratio : INFINITY);
        }
        if (convex) {
            asked = retrax_larger(asked, slope * reach / (1.0 + curvature * reach * reach));
            costs = retrax_larger(costs, i < n ? retrax_larger(curvature * size * size, slope * size) : 0.0);
        }
    }
    for (retrax_index i = n; i < own->z; i++) {
        most = retrax_larger(most, convex ? own->data->room[i - n] / own->push[i] : INFINITY);
    }
    asked = fmax(asked, isfinite(least) ? least : 0.0);
    if (costs > 0.0) {
        any_least = fmin(any_least, sqrt(costs));
    }
    if (isfinite(any_least) && asked <= RETRAX_ROOT_EPS * any_least) {
        asked = any_least;
    }
    return most > 0.0 && most < asked ? most : asked;
}

/* The largest size of a coordinate of the states that controls move without bound, as where a plant is unstable: what
 * it moves itself, or, if it rests, what it moves while another one does. */
static double farthest_of(const scaling *own, retrax_index a) {
    double moved = 0.0;
    if (own->data->sizes[a] > 0.0) {
        return own->data->sizes[a];
    }
    for (retrax_index b = 0; b < own->n; b++) {
        if (own->reach[b] > 0.0) {
            moved = retrax_larger(moved, own->data->sizes[b] / own->reach[b]);
        }
    }
    return moved > 0.0 ? moved * own->reach[a] : INFINITY;
}

/* The most that a coordinate changes the cost by that moves by its size. */
static double most_cost(const scaling *own, const double *unknowns) {
    double most = 0.0;
    for (retrax_index i = 0; i < own->z; i++) {
        const double x = unknowns[i];
        most = retrax_larger(most, retrax_larger(own->curvature[i] * x * x, own->slope[i] * x));
    }
    return most;
}

/* What a coordinate moves by that changes the cost by so much; 0 if its cost is not curved. */
static double costly(double curvature, double slope, double most) {
    if (!(curvature > 0.0 && most < INFINITY)) {
        return 0.0;
    }
    const double far = sqrt(most / curvature);
    return slope > 0.0 ? fmin(far, most / slope) : far;
}

/* Writes the sizes of the unknowns of a trajectory of this size. */
static void write_unknowns(const scaling *own, double size, double *unknowns) {
    const retrax_index n = own->n;
    for (retrax_index i = 0; i < own->z; i++) {
        double found = retrax_larger(own->data->sizes[i], size * own->reach[i]);
        if (i < n && explodes(own, i)) {
            found = fmin(found, farthest_of(own, i));
        }
        unknowns[i] = or_one(found > 0.0 ? found : own->data->values[i]);
    }
    const double most = most_cost(own, unknowns);
    for (retrax_index i = 0; i < own->z; i++) {
        const double far = MATTERS * costly(own->curvature[i], own->slope[i], most);
        const bool confined = i >= n && own->data->room[i - n] > 0.0;
        unknowns[i] = fmax(unknowns[i], confined ? fmin(far, own->data->room[i - n]) : far);
    }
}

/* Raises sizes that are next to nothing beside what each step makes of the size of another coordinate, as that of the
 * rate of a body between two that pull equally. */
static void balance(const scaling *own, double *nodes) {
    const retrax_index n = own->n;
    bool raised = true;
    for (retrax_index round = 0; round < n && raised; round++) {
        raised = false;
        for (retrax_index a = 0; a < n; a++) {
            for (retrax_index c = 0; c < n; c++) {
                const double moved = own->gains[a * n + c] * nodes[c];
                if (a != c && nodes[a] < moved && moved < INFINITY) {
                    nodes[a] = moved;
                    raised = true;
                }
            }
        }
    }
}

void retrax_measure_scale(const retrax_layout *layout, const double *trajectory, const retrax_scale_data *data,
                          void *workspace, retrax_instruction_set set, retrax_scale *scale) {
    scaling own = {.layout = layout, .trajectory = trajectory, .data = data, .set = set};
    retrax_block block = {workspace, 0};
    const retrax_index n = layout->problem->state_size, z = layout->count[RETRAX_ARRAY_PARTS];
    lay_out(&own, &block, layout->problem->steps, n, z);
    own.kernels = retrax_kernels_for(set);
    for (int t = 0; t < 2; t++) { /* columns behind the last one stay zero */
        memset(own.far[t], 0, sizeof(double) * (size_t)(z * own.width));
    }
    sum_costs(&own);
    bool convex = data->curved;
    for (retrax_index i = n; i < z; i++) {
        convex = convex && own.curvature[i] > 0.0;
    }
    write_push(&own, convex);
    for (retrax_index i = 0; i < n * n; i++) {
        own.gains[i] = INFINITY;
    }
    const double from_start = walk(&own, false), from_end = walk(&own, true);
    for (retrax_index a = 0; a < n; a++) {
        const double found = reached(&own, a, 0);
        own.reach[a] = found > RETRAX_ROOT_EPS * reached(&own, a, 1) ? found : 0.0;
    }
    write_unknowns(&own, size_of(&own, fmin(from_start, from_end), convex), scale->unknowns);
    balance(&own, scale->unknowns);
    memcpy(scale->nodes, scale->unknowns, sizeof(double) * (size_t)n);
    scale->cost = or_one(most_cost(&own, scale->unknowns) / (double)own.N);
}
