/*
 * Response: how a trajectory whose ends are coupled follows them.
 *
 * It is eliminated with its start prescribed to move by e, and its end free, with a linear cost f of what that moves by,
 * w = R d: with both prescribed an arc without controls would have dependent equations. The end is held by a weight
 * rho |w|^2 / 2, which the border takes back, so that focal points are no singular pivots.
 */
#include "search.h"

#include <string.h>

/* Weight on the motion of an end, times the number of stages, as in the block elimination. */
#define WEIGHT 256.0

/* Lists the free coordinates of both ends. */
static void list_free(const retrax_layout *layout, const double *trajectory, retrax_response *own) {
    const retrax_index N = layout->problem->steps, n = layout->problem->state_size;
    for (int side = 0; side < 2; side++) {
        own->counts[side] = 0;
        for (retrax_index a = 0; a < n; a++) {
            if (ARRAY(FIXED)[(side == 0 ? 0 : N * n) + a] == 0.0) {
                own->free[side * n + own->counts[side]++] = a;
            }
        }
    }
    own->columns = 1 + own->counts[0] + n;
}

/* Writes the right-hand sides, and adds the weight on the end to the Hessian of the last stage, which is kept. */
static void write_columns(const retrax_layout *layout, const double *trajectory, const retrax_block_system *of,
                          double *hessian, retrax_response *own) {
    const retrax_index N = of->stages, n = of->node_size, z = of->stage_size;
    const retrax_index columns = own->columns, p = own->counts[0];
    const double *const right = of->right + (N - 1) * n * z;
    const double *const after = retrax_collocates(layout->problem) ? ARRAY(AFTER) + (N - 1) * n : own->none;
    memset(own->slope, 0, sizeof(double) * (size_t)(N * z * columns));
    memset(own->defect, 0, sizeof(double) * (size_t)((N + 1) * n * columns));
    for (retrax_index i = 0; i < N * z; i++) {
        own->slope[i * columns] = of->slope[i];
    }
    for (retrax_index i = 0; i < (N + 1) * n; i++) {
        own->defect[i * columns] = of->defect[i];
    }
    for (retrax_index i = 0; i < p; i++) {
        own->defect[own->free[i] * columns + 1 + i] = -1.0;
    }
    retrax_copy(own->last, hessian, z * z);
    for (retrax_index a = 0; a < n; a++) {
        for (retrax_index i = 0; i < z; i++) {
            const double weighted = own->weights[a] * right[a * z + i];
            double *const slope = own->slope + ((N - 1) * z + i) * columns;
            slope[0] += weighted * after[a];
            slope[1 + p + a] = right[a * z + i];
            for (retrax_index j = 0; j < z; j++) {
                hessian[i * z + j] += weighted * right[a * z + j];
            }
        }
    }
}

/* Writes what the end moves by. */
static void write_end(const retrax_layout *layout, const double *trajectory, const retrax_block_system *of,
                      retrax_response *own) {
    const retrax_index N = of->stages, n = of->node_size, z = of->stage_size, columns = own->columns;
    const double *const right = of->right + (N - 1) * n * z, *const steps = own->steps + (N - 1) * z * columns;
    for (retrax_index a = 0; a < n; a++) {
        for (retrax_index j = 0; j < columns; j++) {
            double sum = 0.0;
            for (retrax_index i = 0; i < z; i++) {
                sum += right[a * z + i] * steps[i * columns + j];
            }
            own->end[a * columns + j] = sum;
        }
        own->end[a * columns] += retrax_collocates(layout->problem) ? ARRAY(AFTER)[(N - 1) * n + a] : 0.0;
    }
}

/* Writes the weights on the end, and which equations of the ends count: all at the start, none at the end. */
static void weigh(const retrax_phase *phase, retrax_response *own) {
    const double each = WEIGHT * (double)phase->layout->problem->steps * phase->steps.cost;
    for (retrax_index a = 0; a < phase->layout->problem->state_size; a++) {
        own->weights[a] = each / (phase->steps.nodes[a] * phase->steps.nodes[a]);
        own->ones[a] = 1.0;
        own->none[a] = 0.0;
    }
}

retrax_inertia retrax_respond(const retrax_search *search, retrax_phase *phase, double regularisation) {
    const retrax_layout *const layout = phase->layout;
    double *const trajectory = search->at + phase->place;
    retrax_block_system of = retrax_newton_system(search, phase, regularisation);
    const retrax_index size = of.stage_size * of.stage_size;
    retrax_response *const own = &phase->response;
    double *const last = ARRAY(HESSIANS) + (of.stages - 1) * size;
    list_free(layout, trajectory, own);
    weigh(phase, own);
    write_columns(layout, trajectory, &of, last, own);
    of.columns = own->columns;
    of.slope = own->slope;
    of.defect = own->defect;
    of.fixed_start = own->ones;
    of.fixed_end = own->none;
    retrax_block_solution solution = {
        .step = own->steps, .multipliers = own->multipliers, .finite = own->finite, .largest_step = own->largest};
    retrax_block_eliminate(&of, &solution, search->workspace, search->set);
    retrax_copy(last, own->last, size);
    write_end(layout, trajectory, &of, own);
    return solution.inertia;
}
