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
#define HELD 1e-15
/* Rounds of scaling rows and columns to one size. */
#define ROUNDS 3

/* Sizes of the border, and where its unknowns begin: e, w, f and the multipliers of the equations. */
typedef struct {
    retrax_index ends, forces, equations, total;
} border_sizes;

static double *row_of(const retrax_border *border, retrax_index i) {
    return border->front.matrix + i * border->front.width;
}

/* ---------------------------------------------------------------------------------------------------------- border */

/* Writes what the ends cost and the equations between them, and the sizes of the unknowns; places: of the free
 * coordinates of all starts, then of all ends, among the coordinates of all ends. */
static border_sizes write_coupling(retrax_search *search, retrax_index *places) {
    retrax_border *const border = &search->coupling.border;
    const double *const at = search->at, *const curvature = at + search->coupling.first[RETRAX_COUPLED_CURVATURE];
    const double *const jacobian = at + search->coupling.first[RETRAX_COUPLED_JACOBIAN];
    const double *const values = at + search->coupling.first[RETRAX_COUPLED_VALUES];
    const retrax_index Z = search->coupling.count[RETRAX_COUPLED_MOVES];
    border_sizes own = {0, Z / 2, search->coupling.count[RETRAX_COUPLED_VALUES], 0};
    for (int side = 0; side < 2; side++) {
        EACH_PHASE(phase) {
            const retrax_response *const response = &phase->response;
            const retrax_index n = phase->layout->problem->state_size;
            for (retrax_index i = 0; i < response->counts[side]; i++) {
                const retrax_index a = response->free[side * n + i];
                border->scales[own.ends] = phase->steps.nodes[a];
                places[own.ends++] = response->coordinate + side * n + a;
            }
        }
    }
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

/* Adds the response of a phase, whose e, w and f begin at these rows. */
static void add_response(retrax_border *border, const retrax_phase *phase, const double *trajectory,
                         const border_sizes *sizes, const retrax_index begins[3]) {
    const retrax_layout *const layout = phase->layout;
    const retrax_response *const own = &phase->response;
    const retrax_index n = layout->problem->state_size, N = layout->problem->steps, p = own->counts[0];
    const retrax_index columns = own->columns, e = begins[0], w = begins[1], f = begins[2];
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
    for (int round = 0; round <= ROUNDS; round++) {
        for (retrax_index i = 0; i < total; i++) {
            for (retrax_index j = 0; j < total; j++) {
                row_of(border, i)[j] *= own[i] * own[j];
            }
        }
        for (retrax_index i = 0; i < total && round < ROUNDS; i++) {
            double most = 0.0;
            for (retrax_index j = 0; j < total; j++) {
                most = fmax(most, fabs(row_of(border, i)[j]));
            }
            own[i] = most > 0.0 ? 1.0 / sqrt(most) : 1.0;
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
        row_of(border, i)[i] -= HELD;
    }
    double sum = 0.0; /* 0, or NaN where a number is not finite */
    for (retrax_index i = 0; i < total; i++) {
        for (retrax_index j = 0; j <= total; j++) {
            sum += 0.0 * row_of(border, i)[j];
        }
    }
    retrax_inertia inertia = {0, 0.0};
    if (sum == 0.0) {
        const retrax_kernels *const kernels = retrax_kernels_for(search->set);
        inertia = retrax_front_factorise(kernels, &border->front, total, 0, NULL, 0, &border->pivots);
        retrax_front_substitute(&border->front, total, &border->pivots, 0, border->solution, border->work);
    }
    for (retrax_index i = 0; i < total; i++) {
        border->solution[i] = sum == 0.0 ? border->solution[i] * border->scales[i] : NAN;
    }
    return inertia;
}

/* ------------------------------------------------------------------------------------------------------------ step */

/* Sum of d' H d and of the squares of d in natural sizes over the stages, and the largest steps. */
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
static bool write_step(const retrax_border *border, retrax_phase *phase, double *trajectory,
                       const retrax_index begins[3]) {
    const retrax_layout *const layout = phase->layout;
    const retrax_index N = layout->problem->steps, n = layout->problem->state_size;
    retrax_response *const own = &phase->response;
    const double *const force = border->solution + begins[2];
    double *const last = ARRAY(MULTIPLIER_STEPS) + N * n, sum = 0.0;
    own->factors[0] = 1.0;
    retrax_copy(own->factors + 1, border->solution + begins[0], own->counts[0]);
    retrax_copy(own->factors + 1 + own->counts[0], force, n);
    combine(own, own->steps, layout->count[RETRAX_ARRAY_STEPS], ARRAY(STEPS));
    combine(own, own->multipliers, N * n, ARRAY(MULTIPLIER_STEPS));
    for (retrax_index a = 0; a < n; a++) {
        last[a] = -(force[a] + own->weights[a] * ARRAY(ASKED)[N * n + a]);
    }
    for (retrax_index i = 0; i < own->counts[1]; i++) {
        const retrax_index a = own->free[n + i];
        last[a] = -(force[a] + own->weights[a] * border->solution[begins[1] + i]);
    }
    for (retrax_index i = 0; i < layout->count[RETRAX_ARRAY_STEPS]; i++) {
        sum += 0.0 * ARRAY(STEPS)[i];
    }
    for (retrax_index i = 0; i < (N + 1) * n; i++) {
        sum += 0.0 * ARRAY(MULTIPLIER_STEPS)[i];
    }
    return sum == 0.0;
}

/* Moves the rows at which e, w and f of a phase begin to those of the next one. */
static void next_rows(const retrax_phase *phase, retrax_index begins[3]) {
    begins[0] += phase->response.counts[0];
    begins[1] += phase->response.counts[1];
    begins[2] += phase->layout->problem->state_size;
}

/* Where e, w and f of the first phase begin. */
static void first_rows(const retrax_search *search, const border_sizes *sizes, retrax_index begins[3]) {
    begins[0] = begins[1] = 0;
    begins[2] = sizes->ends;
    EACH_PHASE(phase) { begins[1] += phase->response.counts[0]; }
}

/* Writes what the ends move by, and the steps of the multipliers; returns the curvature of the ends along that. */
static double write_moves(const retrax_search *search, const border_sizes *sizes, const retrax_index *places) {
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

void retrax_eliminate_coupled(retrax_search *search, double shift) {
    retrax_border *const border = &search->coupling.border;
    retrax_direction *const found = &search->direction;
    retrax_index *const places = search->coupling.free_places, begins[3], count = 0, first = 0;
    retrax_inertia inertia = {0, INFINITY};
    EACH_PHASE(phase) {
        const retrax_inertia own = retrax_respond(search, phase, shift);
        phase->response.coordinate = first;
        first += 2 * phase->layout->problem->state_size;
        count += phase->layout->count[RETRAX_ARRAY_DEFECTS];
        inertia.negative += own.negative;
        inertia.smallest = own.smallest < inertia.smallest || isnan(own.smallest) ? own.smallest : inertia.smallest;
    }
    const border_sizes sizes = write_coupling(search, places);
    first_rows(search, &sizes, begins);
    EACH_PHASE(phase) {
        add_response(border, phase, search->at + phase->place, &sizes, begins);
        next_rows(phase, begins);
    }
    const retrax_inertia own = solve_border(search, border, sizes.total);
    const double smallest = own.smallest < inertia.smallest ? own.smallest : inertia.smallest;
    double curvature = write_moves(search, &sizes, places), size = 0.0;
    first_rows(search, &sizes, begins);
    found->finite = true;
    EACH_PHASE(phase) {
        double *const trajectory = search->at + phase->place;
        found->finite = write_step(border, phase, trajectory, begins) && found->finite;
        summarise(phase->layout, trajectory, phase, &curvature, &size);
        next_rows(phase, begins);
    }
    for (retrax_index i = sizes.ends + sizes.forces; i < sizes.total; i++) {
        found->finite = found->finite && isfinite(border->solution[i]);
    }
    found->shift = shift;
    found->curvature = curvature / search->phases->steps.cost + shift * size;
    found->size = size;
    found->smallest = smallest;
    found->convex = inertia.negative + own.negative == count + sizes.forces + sizes.equations;
    found->strict = found->convex && retrax_is_clear(smallest, count);
}

void retrax_add_coupled_promise(retrax_search *search) {
    const double *const at = search->at, *const moves = at + search->coupling.first[RETRAX_COUPLED_MOVES];
    const double *const multipliers = at + search->coupling.first[RETRAX_COUPLED_COORDINATES];
    const double *const steps = at + search->coupling.first[RETRAX_COUPLED_COORDINATE_STEPS];
    const double *const values = at + search->coupling.first[RETRAX_COUPLED_VALUES];
    const retrax_index Z = search->coupling.count[RETRAX_COUPLED_MOVES];
    const double unit = search->direction.reach / search->phases->steps.cost;
    double pulled = 0.0, changed = 0.0;
    for (retrax_index r = 0; r < search->coupling.count[RETRAX_COUPLED_VALUES]; r++) {
        const double *const row = at + search->coupling.first[RETRAX_COUPLED_JACOBIAN] + r * Z;
        for (retrax_index i = 0; i < Z; i++) {
            pulled += multipliers[r] * row[i] * moves[i];
        }
        changed += steps[r] * values[r];
    }
    search->direction.promised -= unit * pulled; /* the costs of the ends have the multipliers times the equations */
    search->direction.turned += unit * changed;
}
