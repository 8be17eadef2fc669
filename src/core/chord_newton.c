/*
 * Newton's method for the equations of a substep, in all lanes of a block at once.
 *
 * The iteration and its constants are those of manifolds/numerics/chord_newton.py, which solves such equations in JAX.
 */
#include "chord_newton.h"

#include <float.h>
#include <math.h>
#include <string.h>

/* Chord steps with one Jacobian, and Jacobians of one substep. */
#define MAX_CHORDS 16
#define MAX_JACOBIANS 15
/* Second derivatives, in units of the unknowns, up to which Newton steps are known to be quadratic. */
#define LARGEST_CURVATURE 1e8
/* Ratios of successive steps: the Jacobian is renewed above the one, a step is not taken above the other. */
#define SLOW_RATIO 0.2
#define STALLED 0.5
/* Step, in units of the unknowns, from which on one that hardly shrinks is rounding: the precision to the power .65. */
#define QUADRATIC 6.686304433952516e-11
/* The unknowns are known where so much of their sizes remains. */
#define SMALLEST (0.25 * DBL_EPSILON)
/* Unknowns are moved by so many of their roundings, and steps of so many of the changes that follow are rounding. */
#define PROBE 8.0
/* Chord steps that are spent on a Jacobian that is kept from step to step count only beyond this many. */
#define PATIENCE 6.0
/* Chord steps in whose time the derivative along one direction is computed. */
#define PUSH_COST 3.0

static double *numbers(retrax_block *block, retrax_index rows, retrax_index columns) {
    return retrax_take(block, rows, columns, sizeof(double));
}

retrax_lanes retrax_lay_out_lanes(const retrax_method *method, retrax_block *block) {
    const retrax_index L = method->lanes, m = method->unknowns;
    retrax_lanes own = {.method = method, .lanes = L, .unknowns = m};
    own.memory = numbers(block, method->rows + (L == 1 ? m * m : m), L);
    double **const vectors[] = {&own.scaled, &own.units, &own.change, &own.unmoved, &own.changed, &own.weights};
    for (size_t i = 0; i < sizeof vectors / sizeof *vectors; i++) {
        *vectors[i] = numbers(block, m, L);
    }
    double **const each[] = {&own.length, &own.step,  &own.chords,    &own.order,
                             &own.taken,  &own.going, &own.converged, &own.good};
    for (size_t i = 0; i < sizeof each / sizeof *each; i++) {
        *each[i] = numbers(block, L, 1);
    }
    own.controls = numbers(block, method->substeps * method->controls, L);
    own.pivots = retrax_take(block, m, L, sizeof(retrax_index));
    return own;
}

double *retrax_rows_of(const retrax_lanes *own, retrax_step_rows part) {
    return own->memory + own->method->first[part] * own->lanes;
}

void retrax_evaluate_step(const retrax_lanes *own, retrax_step_function name, double *outputs, retrax_index points) {
    const retrax_method *const method = own->method;
    const retrax_index L = own->lanes, m = own->unknowns, size = method->rows * L + m * (L == 1 ? m : L);
    const retrax_tape_data data = {own->memory, size, method->sources[name],
                                   outputs, outputs == own->memory ? size : m * m * L, method->targets[name]};
    method->functions[name].evaluate(method->functions[name].context, &data, points);
}

/* ----------------------------------------------------------------------------------------- inverse Jacobians */

/* Takes so much of row k from row i that nothing stands in column k. */
static void sweep_row(retrax_index m, retrax_index L, double *a, retrax_index i, retrax_index k) {
    double *const row = a + i * m * L, *const factor = row + k * L;
    const double *const pivot_row = a + k * m * L;
    for (retrax_index column = 0; column < m; column++) {
        for (retrax_index j = 0; column != k && j < L; j++) {
            row[column * L + j] -= factor[j] * pivot_row[column * L + j];
        }
    }
    for (retrax_index j = 0; j < L; j++) {
        factor[j] *= -pivot_row[k * L + j];
    }
}

/* Divides row k by its pivot in each lane, the entry of column k that is largest in proportion to its row, and
 * exchanges rows for that. */
static void choose_pivots(const retrax_lanes *own, retrax_index k) {
    const retrax_index L = own->lanes, m = own->unknowns;
    double *const a = own->inverse, *const weights = own->weights;
    for (retrax_index j = 0; j < L; j++) {
        retrax_index best = k;
        for (retrax_index i = k + 1; i < m; i++) {
            const double size = fabs(a[(i * m + k) * L + j]), largest = fabs(a[(best * m + k) * L + j]);
            best = size * weights[best * L + j] > largest * weights[i * L + j] ? i : best;
        }
        own->pivots[k * L + j] = best;
        const double weight = weights[best * L + j];
        weights[best * L + j] = weights[k * L + j];
        weights[k * L + j] = weight;
        const double entry = a[(best * m + k) * L + j], pivot = isfinite(entry) ? entry : NAN; /* else no step is left */
        for (retrax_index i = 0; i < m; i++) {
            const double held = i == k ? 1.0 : a[(best * m + i) * L + j];
            a[(best * m + i) * L + j] = a[(k * m + i) * L + j];
            a[(k * m + i) * L + j] = held / pivot;
        }
    }
}

/* Inverts the matrix of each lane in place, by the method of Gauss and Jordan with partial pivoting. Rows are compared
 * in units of their largest entries, the unknowns in their own: positions and momenta, and so their equations, have
 * units of their own. */
static void invert(const retrax_lanes *own) {
    const retrax_index L = own->lanes, m = own->unknowns;
    double *const a = own->inverse;
    const double *const sizes = retrax_rows_of(own, RETRAX_ROWS_SIZES);
    for (retrax_index i = 0; i < m; i++) {
        double *const weight = own->weights + i * L;
        memset(weight, 0, sizeof(double) * (size_t)L);
        for (retrax_index column = 0; column < m; column++) {
            for (retrax_index j = 0; j < L; j++) {
                const double size = fabs(a[(i * m + column) * L + j]) * sizes[column * L + j];
                weight[j] = size > weight[j] ? size : weight[j];
            }
        }
    }
    for (retrax_index k = 0; k < m; k++) {
        choose_pivots(own, k);
        for (retrax_index i = 0; i < m; i++) {
            if (i != k) {
                sweep_row(m, L, a, i, k);
            }
        }
    }
    for (retrax_index k = m - 1; k >= 0; k--) {
        for (retrax_index j = 0; j < L; j++) {
            const retrax_index other = own->pivots[k * L + j];
            for (retrax_index i = 0; i < m; i++) {
                const double held = a[(i * m + k) * L + j];
                a[(i * m + k) * L + j] = a[(i * m + other) * L + j];
                a[(i * m + other) * L + j] = held;
            }
        }
    }
}

/* Writes the unknowns, moved by so many of their roundings, every other one to the other side if `turns`. */
static void place(const retrax_lanes *own, double moves, bool turns) {
    const retrax_index L = own->lanes;
    const double *const sizes = retrax_rows_of(own, RETRAX_ROWS_SIZES);
    double *const c = retrax_rows_of(own, RETRAX_ROWS_UNKNOWNS);
    for (retrax_index i = 0; i < own->unknowns; i++) {
        const double moved = (turns && i % 2 == 1 ? -moves : moves) * DBL_EPSILON;
        for (retrax_index j = i * L; j < (i + 1) * L; j++) {
            const double x = own->scaled[j], size = fabs(x);
            c[j] = (x + moved * (size > 1.0 ? size : 1.0)) * sizes[j];
        }
    }
}

/* Computes inverse Jacobians at the unknowns of all lanes: columns are derivatives along directions, of a single lane
 * all at once. */
static void renew(const retrax_lanes *own) {
    const retrax_index L = own->lanes, m = own->unknowns, points = L == 1 ? m : L;
    double *const directions = own->memory + own->method->rows * L;
    place(own, 0.0, false);
    for (retrax_index begin = 0; begin < m; begin += L == 1 ? m : 1) {
        for (retrax_index i = 0; i < m; i++) {
            for (retrax_index j = 0; j < points; j++) {
                directions[i * points + j] = i == begin + (L == 1 ? j : 0) ? 1.0 : 0.0;
            }
        }
        retrax_evaluate_step(own, RETRAX_STEP_PUSH, own->inverse + begin * L, points);
    }
    invert(own);
}

/* ------------------------------------------------------------------------------------------------ chord steps */

/* Writes the Newton step in units of the unknowns, and the largest of its entries; NaN if one is. */
static inline void apply_inverse(const retrax_lanes *own, retrax_index L) {
    const retrax_index m = own->unknowns;
    const double *const missed = retrax_rows_of(own, RETRAX_ROWS_RESIDUAL);
    memset(own->length, 0, sizeof(double) * (size_t)L);
    for (retrax_index i = 0; i < m; i++) {
        double *const change = own->change + i * L;
        memset(change, 0, sizeof(double) * (size_t)L);
        for (retrax_index column = 0; column < m; column++) {
            const double *const entries = own->inverse + (i * m + column) * L;
            for (retrax_index j = 0; j < L; j++) {
                change[j] += entries[j] * missed[column * L + j];
            }
        }
        for (retrax_index j = 0; j < L; j++) {
            change[j] *= own->units[i * L + j];
            const double size = fabs(change[j]), largest = own->length[j];
            own->length[j] = size <= largest || largest != largest ? largest : size;
        }
    }
}

/* Computes the Newton step at the unknowns, moved as `place` does. */
static void compute_step(const retrax_lanes *own, double moves, bool turns) {
    place(own, moves, turns);
    retrax_evaluate_step(own, RETRAX_STEP_RESIDUAL, own->memory, own->lanes);
    if (own->lanes == 1) {
        apply_inverse(own, 1); /* the compiler leaves out the loops over lanes */
    } else {
        apply_inverse(own, own->lanes);
    }
}

/* Decides of a lane that goes on whether its Newton step is taken, whether it has converged, and whether it goes on. */
static void judge(const retrax_lanes *own, retrax_index j, retrax_index n, bool exact) {
    const double step = own->length[j], ratio = step / (n == 0 ? INFINITY : own->step[j]);
    /* What further steps take away. Near rounding steps shrink as they like, and take less time than a Jacobian. */
    const double shrinks = n == 0 ? (exact ? LARGEST_CURVATURE * step : 1.0) : (n == 1 ? sqrt(ratio) : ratio);
    const bool stalled = step <= QUADRATIC && ratio > STALLED && n > 0;
    const bool done = step * (shrinks < 1.0 ? shrinks : 1.0) <= SMALLEST || stalled;
    own->taken[j] = ratio <= STALLED ? 1.0 : 0.0; /* one that hardly shrinks is the fault of an old Jacobian */
    own->step[j] = step;
    own->chords[j] = (double)(n + 1);
    own->converged[j] = done ? 1.0 : 0.0;
    own->going[j] = !done && (n == 0 || ratio < SLOW_RATIO || step <= QUADRATIC) ? 1.0 : 0.0;
}

/* Makes steps with one inverse Jacobian for each lane, `exact` at the first of them, until they converge or shrink too
 * slowly. */
static void chord_steps(const retrax_lanes *own, bool exact) {
    const retrax_index L = own->lanes;
    for (retrax_index n = 0; n < MAX_CHORDS; n++) {
        bool more = false;
        compute_step(own, 0.0, false);
        for (retrax_index j = 0; j < L; j++) {
            own->taken[j] = 0.0;
            if (own->going[j] != 0.0) {
                judge(own, j, n, exact);
                more = more || own->going[j] != 0.0;
            }
        }
        for (retrax_index i = 0; i < own->unknowns; i++) {
            for (retrax_index j = 0; j < L; j++) {
                own->scaled[i * L + j] -= own->taken[j] != 0.0 ? own->change[i * L + j] : 0.0;
            }
        }
        if (!more) {
            return;
        }
    }
}

/* Lanes whose steps do not shrink have converged where the step changes as much by the rounding of the unknowns. */
static void probe_rounding(const retrax_lanes *own) {
    const retrax_index L = own->lanes, count = own->unknowns * L;
    bool some = false;
    for (retrax_index j = 0; j < L; j++) {
        some = some || (own->converged[j] == 0.0 && isfinite(own->step[j]));
    }
    if (!some) {
        return;
    }
    compute_step(own, 0.0, false);
    memcpy(own->unmoved, own->change, sizeof(double) * (size_t)count);
    memset(own->changed, 0, sizeof(double) * (size_t)count);
    for (int pattern = 0; pattern < 3; pattern++) { /* unknowns beside these, to either side in turn and all to one */
        compute_step(own, pattern == 1 ? -PROBE : PROBE, pattern < 2);
        for (retrax_index k = 0; k < count; k++) {
            const double change = fabs(own->change[k] - own->unmoved[k]);
            own->changed[k] = change > own->changed[k] ? change : own->changed[k];
        }
    }
    for (retrax_index j = 0; j < L; j++) {
        bool rounding = isfinite(own->length[j]);
        for (retrax_index k = j; k < count; k += L) { /* each by itself: one next to nothing changes by any amount */
            const double change = own->changed[k] > SMALLEST ? own->changed[k] : SMALLEST;
            rounding = rounding && fabs(own->unmoved[k]) <= PROBE * change;
        }
        own->converged[j] = rounding ? 1.0 : own->converged[j];
    }
}

/* ------------------------------------------------------------------------------------------------------ steps */

/* Where lanes begin that go on. */
typedef enum { FROM_HERE, FROM_PREDICTION_IF_LED_AWAY, FROM_PREDICTION } beginning;

/* Chooses the lanes that go on, all good lanes if `anew`, else those that have not converged; whether there are any. */
static bool begin_lanes(const retrax_lanes *own, bool anew, beginning from) {
    const retrax_index L = own->lanes;
    const double *const first = retrax_rows_of(own, RETRAX_ROWS_FIRST);
    bool some = false;
    for (retrax_index j = 0; j < L; j++) {
        bool going = own->good[j] != 0.0 && (anew || own->converged[j] == 0.0);
        const bool back = from == FROM_PREDICTION || (from == FROM_PREDICTION_IF_LED_AWAY && !(own->step[j] < 1.0));
        for (retrax_index k = j; k < own->unknowns * L; k += L) {
            own->scaled[k] = going && back ? first[k] * own->units[k] : own->scaled[k];
        }
        if (anew) {
            own->converged[j] = own->chords[j] = 0.0;
        }
        for (retrax_index k = j; k < own->unknowns * L; k += L) {
            going = going && isfinite(own->scaled[k]);
        }
        own->going[j] = going ? 1.0 : 0.0;
        some = some || going;
    }
    return some;
}

/* Corrects the prediction by the errors of earlier ones, of the order whose first neglected difference is least. */
static void correct_prediction(const retrax_lanes *own) {
    const retrax_index L = own->lanes, count = own->unknowns * L;
    double *const largest = own->length, *const least = own->step;
    for (retrax_index j = 0; j < L; j++) {
        own->order[j] = 0.0;
        least[j] = INFINITY;
    }
    for (retrax_index n = 0; n < RETRAX_ORDERS; n++) {
        memset(largest, 0, sizeof(double) * (size_t)L);
        for (retrax_index i = 0; i < own->unknowns; i++) {
            for (retrax_index j = 0; j < L; j++) {
                const double size = fabs(own->differences[n * count + i * L + j]) * own->units[i * L + j];
                largest[j] = size > largest[j] ? size : largest[j];
            }
        }
        for (retrax_index j = 0; j < L; j++) {
            own->order[j] = largest[j] < least[j] ? (double)n : own->order[j];
            least[j] = largest[j] < least[j] ? largest[j] : least[j];
        }
    }
    for (retrax_index n = 0; n < RETRAX_ORDERS; n++) {
        for (retrax_index i = 0; i < own->unknowns; i++) {
            for (retrax_index j = 0; j < L; j++) {
                const double part = own->differences[n * count + i * L + j] * own->units[i * L + j];
                own->scaled[i * L + j] += (double)n < own->order[j] ? part : 0.0;
            }
        }
    }
}

/* Writes the differences of all orders behind a step: how wrong its prediction was, and how that has changed. */
static void compare_prediction(const retrax_lanes *own) {
    const retrax_index count = own->unknowns * own->lanes;
    const double *const c = retrax_rows_of(own, RETRAX_ROWS_UNKNOWNS), *const first = retrax_rows_of(own, RETRAX_ROWS_FIRST);
    for (retrax_index k = 0; k < count; k++) {
        double change = c[k] - first[k];
        for (retrax_index n = 0; n < RETRAX_ORDERS; n++) {
            const double before = own->differences[n * count + k];
            own->differences[n * count + k] = change;
            change -= before;
        }
    }
}

/* Counts the chord steps that old inverse Jacobians have cost, and renews them where new ones cost less. `renewed`: how
 * often that was done for this step. */
static void weigh_inverses(const retrax_lanes *own, int renewed) {
    double most = 0.0;
    for (retrax_index j = 0; j < own->lanes; j++) {
        most = own->good[j] != 0.0 && own->chords[j] > most ? own->chords[j] : most;
    }
    *own->spent += most > PATIENCE ? most - PATIENCE : 0.0;
    if (renewed > 0) {
        *own->spent = renewed == 1 ? 0.0 : INFINITY; /* what is solved with difficulty says little of the next step */
    } else if (*own->spent > PUSH_COST * (double)own->unknowns) {
        renew(own);
        *own->spent = 0.0;
    }
}

void retrax_solve_substep(const retrax_lanes *own) {
    const retrax_index L = own->lanes, m = own->unknowns;
    const double *const small = own->method->small_step_inverse, *const sizes = retrax_rows_of(own, RETRAX_ROWS_SIZES);
    bool anew = true;
    beginning from = FROM_PREDICTION;
    int renewed = 0;
    for (retrax_index k = 0; k < m * L; k++) {
        own->units[k] = 1.0 / sizes[k];
    }
    if (isfinite(*own->spent)) {
        begin_lanes(own, anew, from);
        correct_prediction(own);
        chord_steps(own, false);
        anew = false;
    }
    if (small != NULL && begin_lanes(own, anew, from)) {
        for (retrax_index k = 0; k < m * m * L; k++) {
            own->inverse[k] = small[k / L];
        }
        chord_steps(own, false);
        *own->spent = INFINITY;
        anew = false;
        from = FROM_PREDICTION_IF_LED_AWAY;
    }
    for (; renewed < MAX_JACOBIANS && begin_lanes(own, anew, from); renewed++) {
        renew(own);
        chord_steps(own, true);
        probe_rounding(own);
        anew = false;
        from = FROM_HERE;
    }
    place(own, 0.0, false);
    compare_prediction(own);
    weigh_inverses(own, renewed);
}
