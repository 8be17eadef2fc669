/*
 * Border: the Newton step of trajectories whose ends are coupled.
 *
 * Each trajectory tells how it follows its ends: the multipliers C of its start and the motion W of its end, per unit
 * that the start moves by, e, and of a linear cost f of what the end moves by, w, which is held by a weight rho. What is
 * left is one system in (e, w, f) of all trajectories and the steps of the multipliers of b(ends) = 0, with L the
 * curvature of the costs of the ends and of the multipliers times b,
 *
 *     (L_ee - C_e) e + L_ew w - C_f f + B_e' dmu = C_0,     L_we e + (L_ww - rho) w - f + B_w' dmu = 0,
 *     W_e e - w + W_f f = -W_0,                             B_e e + B_w w = -b.
 *
 * Prescribed coordinates of the start have no e, those of the end a w that is known. By Haynsworth's formula the inertia
 * of the whole is the sum of those of the eliminated systems and of this one.
 */
#include "search.h"

#include <math.h>
#include <string.h>

/* What the multipliers of equations are held by, rows being scaled to one size: where equations depend on each other and
 * agree, those that rounding leaves free stay small. */
#define MULTIPLIER_REGULARISATION 1e-15
/* Rounds of scaling rows and columns to one size. */
#define SCALINGS 3

/* Numbers of the unknowns of the border: e and w, f, and the multipliers of the equations. */
typedef struct {
    retrax_index ends, forces, equations, total;
} border_sizes;

static double *row_of(const retrax_border *border, retrax_index i) {
    return border->front.matrix + i * border->front.width;
}

/* ---------------------------------------------------------------------------------------------------------- border */

/* Lists the rows of all phases, the sizes of e and w, and their places: of the free coordinates of all starts, then of
 * all ends, among the coordinates of all ends. Returns how many they are. */
static retrax_index list_ends(retrax_search *search) {
    retrax_index count = 0, forces = 0;
    for (int side = 0; side < 2; side++) {
        retrax_index coordinate = 0;
        EACH_PHASE(phase) {
            retrax_response *const own = &phase->response;
            const retrax_index n = phase->layout->problem->state_size;
            own->rows[side] = count;
            for (retrax_index i = 0; i < own->counts[side]; i++) {
                const retrax_index a = own->free[side * n + i];
                search->coupling.border.scales[count] = phase->steps.nodes[a];
                search->coupling.free_places[count++] = coordinate + side * n + a;
            }
            coordinate += 2 * n;
        }
    }
    EACH_PHASE(phase) {
        phase->response.rows[2] = count + forces;
        forces += phase->layout->problem->state_size;
    }
    return count;
}

/* Writes what the ends cost and the equations between them, and the sizes of the unknowns. */
static border_sizes write_coupling(retrax_search *search) {
    retrax_border *const border = &search->coupling.border;
    const retrax_index *const places = search->coupling.free_places;
    const double *const at = search->at, *const curvature = at + search->coupling.first[RETRAX_COUPLED_CURVATURE];
    const double *const jacobian = at + search->coupling.first[RETRAX_COUPLED_JACOBIAN];
    const double *const values = at + search->coupling.first[RETRAX_COUPLED_VALUES];
    const retrax_index Z = search->coupling.count[RETRAX_COUPLED_MOVES];
    border_sizes own = {list_ends(search), Z / 2, search->coupling.count[RETRAX_COUPLED_VALUES], 0};
    own.total = own.ends + own.forces + own.equations;
    border->front.rows = border->front.unknowns = own.total;
    border->front.columns = 1;
    border->front.width = retrax_width(own.total + 1);
    memset(border->front.matrix, 0, sizeof(double) * (size_t)(own.total * border->front.width));
    const retrax_index first = own.ends + own.forces;
    for (retrax_index i = 0; i < own.ends; i++) {
        for (retrax_index j = 0; j < own.ends; j++) {
            row_of(border, i)[j] = curvature[places[i] * Z + places[j]];
        }
        for (retrax_index r = 0; r < own.equations; r++) {
            row_of(border, i)[first + r] = row_of(border, first + r)[i] = jacobian[r * Z + places[i]];
        }
    }
    for (retrax_index r = 0; r < own.equations; r++) {
        row_of(border, first + r)[own.total] = -values[r];
        border->scales[first + r] = search->phases->steps.cost / search->coupling.sizes[r];
    }
    return own;
}

/* Adds the response of a phase. */
static void add_response(retrax_border *border, const retrax_phase *phase, const double *trajectory,
                         const border_sizes *sizes) {
    const retrax_layout *const layout = phase->layout;
    const retrax_response *const own = &phase->response;
    const retrax_index n = layout->problem->state_size, N = layout->problem->steps, p = own->counts[0];
    const retrax_index columns = own->columns, e = own->rows[0], w = own->rows[1], f = own->rows[2];
    for (retrax_index i = 0; i < p; i++) {
        const double *const start = own->multipliers + own->free[i] * columns;
        double *const row = row_of(border, e + i);
        for (retrax_index j = 0; j < p; j++) {
            row[e + j] -= start[1 + j];
        }
        for (retrax_index j = 0; j < n; j++) {
            row[f + j] -= start[1 + p + j];
        }
        row[sizes->total] = start[0];
    }
    for (retrax_index a = 0; a < n; a++) {
        const double *const end = own->end + a * columns;
        double *const row = row_of(border, f + a);
        for (retrax_index j = 0; j < p; j++) {
            row[e + j] += end[1 + j];
        }
        for (retrax_index j = 0; j < n; j++) {
            row[f + j] += end[1 + p + j];
        }
        row[sizes->total] = ARRAY(ASKED)[N * n + a] - end[0];
        border->scales[f + a] = phase->steps.cost / phase->steps.nodes[a];
    }
    for (retrax_index i = 0; i < own->counts[1]; i++) {
        const retrax_index a = own->free[n + i];
        row_of(border, w + i)[f + a] = row_of(border, f + a)[w + i] = -1.0;
        row_of(border, w + i)[w + i] -= own->weights[a];
    }
}

/* Scales rows and columns of the border to one size. */
static void scale_border(retrax_border *border, retrax_index total) {
    double *const own = border->work;
    retrax_copy(own, border->scales, total);
    for (int round = 0; round <= SCALINGS; round++) {
        for (retrax_index i = 0; i < total; i++) {
            for (retrax_index j = 0; j < total; j++) {
                row_of(border, i)[j] *= own[i] * own[j];
            }
        }
        for (retrax_index i = 0; i < total && round < SCALINGS; i++) {
            double most = 0.0;
            for (retrax_index j = 0; j < total; j++) {
                most = fmax(most, fabs(row_of(border, i)[j]));
            }
            own[i] = 1.0 / sqrt(retrax_or_one(most));
            border->scales[i] *= own[i];
        }
    }
    for (retrax_index i = 0; i < total; i++) {
        row_of(border, i)[total] *= border->scales[i];
    }
}

/* Makes the border symmetric: its halves come from different right-hand sides, and differ by rounding. */
static void symmetrise(retrax_border *border, retrax_index total) {
    for (retrax_index i = 0; i < total; i++) {
        for (retrax_index j = 0; j < i; j++) {
            const double mean = (row_of(border, i)[j] + row_of(border, j)[i]) / 2.0;
            row_of(border, i)[j] = row_of(border, j)[i] = mean;
        }
    }
}

/* Solves the border; returns its inertia. A singular one has a solution that is not finite. */
static retrax_inertia solve_border(const retrax_search *search, retrax_border *border, retrax_index total) {
    scale_border(border, total);
    symmetrise(border, total);
    for (retrax_index i = total - search->coupling.count[RETRAX_COUPLED_VALUES]; i < total; i++) {
        row_of(border, i)[i] -= MULTIPLIER_REGULARISATION;
    }
    bool finite = true;
    for (retrax_index i = 0; i < total; i++) {
        finite = finite && retrax_is_finite(row_of(border, i), total + 1);
    }
    retrax_inertia inertia = {0, 0.0};
    if (finite) {
        const retrax_kernels *const kernels = retrax_kernels_for(search->set);
        inertia = retrax_front_factorise(kernels, &border->front, total, 0, NULL, 0, &border->pivots);
        retrax_front_substitute(&border->front, total, &border->pivots, 0, border->solution, border->work);
    }
    for (retrax_index i = 0; i < total; i++) {
        border->solution[i] = finite ? border->solution[i] * border->scales[i] : NAN;
    }
    return inertia;
}

/* ------------------------------------------------------------------------------------------------------------ step */

/* Sum of d' H d and of the squares of d in units of the scaling over the stages, and the largest steps. */
static void summarise(const retrax_layout *layout, const double *trajectory, retrax_phase *phase, double *curvature,
                      double *size) {
    const retrax_index N = layout->problem->steps, z = layout->count[RETRAX_ARRAY_PARTS];
    memset(phase->largest, 0, sizeof(double) * (size_t)z);
    for (retrax_index k = 0; k < N; k++) {
        const double *const d = ARRAY(STEPS) + k * z, *const hessian = ARRAY(HESSIANS) + k * z * z;
        for (retrax_index i = 0; i < z; i++) {
            double image = 0.0;
            for (retrax_index j = 0; j < z; j++) {
                image += hessian[i * z + j] * d[j];
            }
            const double unit = phase->steps.unknowns[i];
            *curvature += d[i] * image;
            *size += d[i] / unit * (d[i] / unit);
            phase->largest[i] = retrax_larger(phase->largest[i], fabs(d[i]));
        }
    }
}

/* to = the columns of a response, combined. */
static void combine(const retrax_response *own, const double *from, retrax_index count, double *to) {
    for (retrax_index i = 0; i < count; i++) {
        to[i] = 0.0;
        for (retrax_index j = 0; j < own->columns; j++) {
            to[i] += from[i * own->columns + j] * own->factors[j];
        }
    }
}

/* Writes the step of a phase whose ends move so; returns whether it is finite. */
static bool write_step(const retrax_border *border, retrax_phase *phase, double *trajectory) {
    const retrax_layout *const layout = phase->layout;
    const retrax_index N = layout->problem->steps, n = layout->problem->state_size;
    retrax_response *const own = &phase->response;
    const double *const force = border->solution + own->rows[2];
    double *const last = ARRAY(MULTIPLIER_STEPS) + N * n;
    own->factors[0] = 1.0;
    retrax_copy(own->factors + 1, border->solution + own->rows[0], own->counts[0]);
    retrax_copy(own->factors + 1 + own->counts[0], force, n);
    combine(own, own->steps, layout->count[RETRAX_ARRAY_STEPS], ARRAY(STEPS));
    combine(own, own->multipliers, N * n, ARRAY(MULTIPLIER_STEPS));
    for (retrax_index a = 0; a < n; a++) {
        last[a] = -(force[a] + own->weights[a] * ARRAY(ASKED)[N * n + a]);
    }
    for (retrax_index i = 0; i < own->counts[1]; i++) {
        const retrax_index a = own->free[n + i];
        last[a] = -(force[a] + own->weights[a] * border->solution[own->rows[1] + i]);
    }
    return retrax_is_finite(ARRAY(STEPS), layout->count[RETRAX_ARRAY_STEPS]) &&
           retrax_is_finite(ARRAY(MULTIPLIER_STEPS), layout->count[RETRAX_ARRAY_MULTIPLIER_STEPS]);
}

/* Writes what the ends move by, and the steps of the multipliers; returns the curvature of the ends along that. */
static double write_moves(const retrax_search *search, const border_sizes *sizes) {
    const retrax_index *const places = search->coupling.free_places;
    const double *const found = search->coupling.border.solution;
    const double *const curvature = search->at + search->coupling.first[RETRAX_COUPLED_CURVATURE];
    double *const moves = search->at + search->coupling.first[RETRAX_COUPLED_MOVES], sum = 0.0;
    const retrax_index Z = search->coupling.count[RETRAX_COUPLED_MOVES];
    memset(moves, 0, sizeof(double) * (size_t)Z);
    for (retrax_index i = 0; i < sizes->ends; i++) {
        moves[places[i]] = found[i];
    }
    for (retrax_index i = 0; i < Z; i++) {
        for (retrax_index j = 0; j < Z; j++) {
            sum += moves[i] * curvature[i * Z + j] * moves[j];
        }
    }
    retrax_copy(search->at + search->coupling.first[RETRAX_COUPLED_COORDINATE_STEPS], found + sizes->ends + sizes->forces,
                sizes->equations);
    return sum;
}

/* Assembles the border of the responses of all phases and solves it; adds its inertia. */
static border_sizes eliminate_border(retrax_search *search, retrax_inertia *inertia) {
    retrax_border *const border = &search->coupling.border;
    const border_sizes sizes = write_coupling(search);
    EACH_PHASE(phase) { add_response(border, phase, search->at + phase->place, &sizes); }
    retrax_add_inertia(inertia, solve_border(search, border, sizes.total));
    return sizes;
}

void retrax_eliminate_coupled(retrax_search *search, double regularisation) {
    retrax_border *const border = &search->coupling.border;
    retrax_direction *const step = &search->direction;
    retrax_index count = 0;
    retrax_inertia inertia = {0, INFINITY};
    EACH_PHASE(phase) {
        const retrax_layout *const layout = phase->layout;
        retrax_add_inertia(&inertia, retrax_respond(search, phase, regularisation));
        count += layout->count[RETRAX_ARRAY_DEFECTS];
    }
    const border_sizes sizes = eliminate_border(search, &inertia);
    double curvature = write_moves(search, &sizes), size = 0.0;
    step->finite = true;
    EACH_PHASE(phase) {
        double *const trajectory = search->at + phase->place;
        step->finite = write_step(border, phase, trajectory) && step->finite;
        summarise(phase->layout, trajectory, phase, &curvature, &size);
    }
    step->finite = step->finite && retrax_is_finite(border->solution + sizes.ends + sizes.forces, sizes.equations);
    step->regularisation = regularisation;
    step->curvature = curvature / search->phases->steps.cost + regularisation * size;
    step->size = size;
    step->inertia_correct = inertia.negative == count + sizes.forces + sizes.equations;
    step->strict = step->inertia_correct && retrax_is_clear(inertia.smallest, count);
}

void retrax_add_coupled_change(retrax_search *search) {
    const double *const at = search->at, *const moves = at + search->coupling.first[RETRAX_COUPLED_MOVES];
    const double *const multipliers = at + search->coupling.first[RETRAX_COUPLED_COORDINATES];
    const double *const steps = at + search->coupling.first[RETRAX_COUPLED_COORDINATE_STEPS];
    const double *const values = at + search->coupling.first[RETRAX_COUPLED_VALUES];
    const retrax_index Z = search->coupling.count[RETRAX_COUPLED_MOVES];
    const double unit = search->direction.alpha_max / search->phases->steps.cost;
    double pulled = 0.0, changed = 0.0;
    for (retrax_index r = 0; r < search->coupling.count[RETRAX_COUPLED_VALUES]; r++) {
        const double *const row = at + search->coupling.first[RETRAX_COUPLED_JACOBIAN] + r * Z;
        for (retrax_index i = 0; i < Z; i++) {
            pulled += multipliers[r] * row[i] * moves[i];
        }
        changed += steps[r] * values[r];
    }
    search->direction.predicted_change -= unit * pulled; /* the costs of the ends have the multipliers times the equations */
    search->direction.constraint_change += unit * changed;
}
