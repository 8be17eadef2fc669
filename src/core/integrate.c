/* Integration: steps of trajectories, blocks of lanes one after the other. */
#include "chord_newton.h"

#include <string.h>

size_t retrax_integration_workspace(const retrax_method *method) {
    retrax_block block = {NULL, 0};
    retrax_lay_out_lanes(method, &block);
    return block.used == SIZE_MAX ? 0 : block.used;
}

/* Makes a step of all good lanes of a block; lanes that fail are good no more. */
static void make_step(retrax_lanes *own, const retrax_integration *integration, retrax_index block) {
    const retrax_method *const method = own->method;
    const retrax_index L = own->lanes, m = own->unknowns, K = method->substeps, T = integration->trajectories;
    double *const h = retrax_rows_of(own, RETRAX_ROWS_STEP_SIZE);
    for (retrax_index k = 0; k < K; k++) {
        own->inverse = integration->inverses + (block * K + k) * m * m * L;
        own->differences = integration->differences + (block * K + k) * RETRAX_ORDERS * m * L;
        own->spent = integration->spent + block * K + k;
        for (retrax_index j = 0; j < L; j++) {
            h[j] = integration->step_sizes[block * L + j < T ? block * L + j : T - 1] * method->parts[k];
        }
        retrax_evaluate_step(own, RETRAX_STEP_PREPARE, own->memory, L);
        retrax_solve_substep(own);
        retrax_evaluate_step(own, RETRAX_STEP_END, own->memory, L);
        const double *const usable = retrax_rows_of(own, RETRAX_ROWS_USABLE);
        for (retrax_index j = 0; j < L; j++) {
            own->good[j] *= own->converged[j] * (usable[j] != 0.0 ? 1.0 : 0.0);
        }
        memcpy(retrax_rows_of(own, RETRAX_ROWS_STATE), retrax_rows_of(own, RETRAX_ROWS_NEXT_STATE),
               sizeof(double) * (size_t)(method->states * L));
        memcpy(own->controls + k * method->controls * L, retrax_rows_of(own, RETRAX_ROWS_CONTROL),
               sizeof(double) * (size_t)(method->controls * L));
    }
}

/* Reads the states of a block; whether any lane is good. Lanes without a trajectory have the state of the last one. */
static bool read_block(const retrax_lanes *own, const retrax_integration *integration, retrax_index block) {
    const retrax_index L = own->lanes, T = integration->trajectories;
    double *const state = retrax_rows_of(own, RETRAX_ROWS_STATE);
    bool moving = false;
    for (retrax_index j = 0; j < L; j++) {
        const bool there = block * L + j < T;
        const retrax_index t = there ? block * L + j : T - 1;
        own->good[j] = there && integration->failed[t] < 0 ? 1.0 : 0.0;
        moving = moving || own->good[j] != 0.0;
        for (retrax_index i = 0; i < own->method->states; i++) {
            state[i * L + j] = integration->carry[i * T + t];
        }
    }
    return moving;
}

/* Writes the states and controls of the good lanes of a block, the step at which others have failed, and the record. */
static void write_block(const retrax_lanes *own, const retrax_integration *integration, retrax_index block,
                        retrax_index step) {
    const retrax_index L = own->lanes, S = own->method->states, T = integration->trajectories;
    const retrax_index carried = S + own->method->substeps * own->method->controls, kept = integration->kept;
    const double *const state = retrax_rows_of(own, RETRAX_ROWS_STATE);
    double *const record = integration->record + (integration->phase + step) / integration->every * kept * T;
    for (retrax_index j = 0; j < L && block * L + j < T; j++) {
        const retrax_index t = block * L + j;
        for (retrax_index i = 0; own->good[j] != 0.0 && i < carried; i++) {
            integration->carry[i * T + t] = i < S ? state[i * L + j] : own->controls[(i - S) * L + j];
        }
        if (own->good[j] == 0.0 && integration->failed[t] < 0) {
            integration->failed[t] = integration->done + step;
        }
        for (retrax_index i = 0; i < kept; i++) {
            record[i * T + t] = integration->carry[(carried - kept + i) * T + t];
        }
    }
}

void retrax_integrate(const retrax_method *method, const retrax_integration *integration, retrax_index first,
                      retrax_index last, void *workspace) {
    retrax_block memory = {workspace, 0};
    retrax_lanes own = retrax_lay_out_lanes(method, &memory);
    memset(own.memory, 0, sizeof(double) * (size_t)(method->rows * method->lanes));
    for (retrax_index block = first; block < last; block++) {
        for (retrax_index step = 0; step < integration->steps; step++) {
            if (read_block(&own, integration, block)) {
                make_step(&own, integration, block);
            }
            write_block(&own, integration, block, step);
        }
    }
}
