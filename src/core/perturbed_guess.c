/*
 * Perturbed guess: the trajectory beside a guess from which Newton's method cannot set out.
 *
 * The controls are moved by waves, and the states to where these lead to first order, until half of what the controls
 * move has moved by half its spread along the trajectory. Of a system such as Heisenberg's group, on the way to a point
 * above the start, something that is spread hardly moves so: there the step is as long as changes what is lacking by as
 * much. Where nothing that is spread moves or bends, as of a car at rest beside the place to park, the controls move by
 * half their size, and the trajectory is perturbed from there.
 */
#include "search.h"

#include <math.h>
#include <string.h>

/* Share of its spread by which a trajectory is moved. */
#define MOVED 0.5
/* Share of its spread: a piece that moves by less has hardly moved. */
#define REACHED 0.05
/* Times that a length is corrected, and that a trajectory at rest is moved. */
#define CORRECTIONS 4
/* Half periods of the fastest wave in the horizon, and one more: the first one is constant. */
#define WAVES 3
#define PI 3.14159265358979323846

/* Writes scaling factors of the controls, by the curvature of the cost, behind ones for the states. */
static void write_control_sizes(retrax_search *search) {
    const retrax_layout *const layout = search->phases->layout;
    const double *const trajectory = search->at;
    for (retrax_index i = 0; i < layout->count[RETRAX_ARRAY_PARTS]; i++) {
        const double curved = i < layout->problem->state_size ? 0.0 : ARRAY(CURVATURES)[i];
        search->phases->sizes[i] = 1.0 / sqrt(retrax_or_one(curved));
    }
}

/* Writes to the trial the Hessian of a cost of the controls in units of the scaling, and the slope of waves in it. */
static void write_waves(retrax_search *search, const double *draws) {
    const retrax_layout *const layout = search->phases->layout;
    double *const trajectory = search->trial;
    const retrax_index N = layout->problem->steps, n = layout->problem->state_size;
    const retrax_index z = layout->count[RETRAX_ARRAY_PARTS];
    memset(ARRAY(HESSIANS), 0, sizeof(double) * (size_t)layout->count[RETRAX_ARRAY_HESSIANS]);
    memset(ARRAY(NEWTON_SIDES), 0, sizeof(double) * (size_t)layout->count[RETRAX_ARRAY_NEWTON_SIDES]);
    memset(ARRAY(NEWTON_DEFECTS), 0, sizeof(double) * (size_t)layout->count[RETRAX_ARRAY_NEWTON_DEFECTS]);
    for (retrax_index k = 0; k < N; k++) {
        const double time = ((double)k + 0.5) / (double)N;
        for (retrax_index i = n; i < z; i++) {
            double wave = 0.0;
            for (int w = 0; w < WAVES; w++) {
                wave += cos(PI * time * w) * draws[w * (z - n) + i - n];
            }
            ARRAY(HESSIANS)[(k * z + i) * z + i] = 1.0 / (search->phases->sizes[i] * search->phases->sizes[i]);
            ARRAY(NEWTON_SIDES)[k * z + i] = -wave / search->phases->sizes[i];
        }
    }
}

/* Writes to the trial the step that waves of the controls make of the linearised iterate, from a fixed start to
 * a free end; its largest entries are search->phases->largest. Returns whether it is finite. */
static bool find_step(retrax_search *search, const double *draws) {
    const retrax_layout *const layout = search->phases->layout;
    const double *const at = search->at, *const ones = search->phases->sizes;
    double *const trajectory = search->trial;
    unsigned char finite;
    write_control_sizes(search);
    write_waves(search, draws);
    const retrax_block_system system = {
        .stages = layout->problem->steps,
        .node_size = layout->problem->state_size,
        .stage_size = layout->count[RETRAX_ARRAY_PARTS],
        .columns = 1,
        .hessian = ARRAY(HESSIANS),
        .left = at + layout->first[RETRAX_ARRAY_LEFT],
        .right = at + layout->first[RETRAX_ARRAY_RIGHT],
        .slope = ARRAY(NEWTON_SIDES),
        .defect = ARRAY(NEWTON_DEFECTS),
        .fixed_start = ones,
        .fixed_end = ARRAY(NEWTON_DEFECTS), /* zeros */
        .stage_scale = search->phases->sizes,
        .node_scale = ones,
        .cost_scale = 1.0,
        .regularisation = 0.0,
        .regularised = search->phases->sizes,
    };
    retrax_block_solution solution = {.step = ARRAY(STEPS),
                                      .multipliers = ARRAY(MULTIPLIER_STEPS),
                                      .finite = &finite,
                                      .largest_step = search->phases->largest};
    retrax_block_eliminate(&system, &solution, search->workspace, search->set);
    return finite != 0;
}

/* Writes the trial: the iterate moved by so many times the step of the trial, which stays, within its cap. */
static void move_by(retrax_search *search, double size) {
    const retrax_layout *const layout = search->phases->layout;
    const double *const steps = search->trial + layout->first[RETRAX_ARRAY_STEPS];
    double *const trajectory = search->at;
    for (retrax_index i = 0; i < layout->count[RETRAX_ARRAY_STEPS]; i++) {
        ARRAY(STEPS)[i] = size > 0.0 ? size * steps[i] : 0.0;
    }
    for (retrax_index i = 0; i < layout->count[RETRAX_ARRAY_PARTS]; i++) {
        search->phases->values[i] = size > 0.0 ? size * search->phases->largest[i] : 0.0;
    }
    memset(ARRAY(MULTIPLIER_STEPS), 0, sizeof(double) * (size_t)layout->count[RETRAX_ARRAY_MULTIPLIER_STEPS]);
    retrax_expand_step(layout, trajectory, search->workspace);
    /* The cap marks columns of constant norm where the pieces were found, which are found again when they are needed. */
    const double cap = retrax_step_cap(layout, trajectory, search->phases->values, search->trial, search->phases->constant_norm);
    retrax_copy_unknowns(layout, trajectory, search->trial);
    retrax_move_trajectory(layout, trajectory, cap, search->trial);
}

/* Returns how many times the step is half of what is spread, in the median of the pieces that it moves; 0 if there is
 * none. */
static double typical_size(retrax_search *search) {
    const retrax_index E = search->phases->layout->problem->state_numbers;
    double *const shares = search->phases->work;
    retrax_index count = 0;
    for (retrax_index e = 0; e < E; e++) {
        const retrax_piece piece = retrax_piece_of(search, e);
        if (piece.first == e && piece.far > 0.0 && piece.spread > 0.0) {
            const double share = piece.far / piece.spread;
            retrax_index place = count++;
            for (; place > 0 && shares[place - 1] > share; place--) {
                shares[place] = shares[place - 1];
            }
            shares[place] = share;
        }
    }
    return count > 0 ? MOVED / shares[(count - 1) / 2] : 0.0;
}

/* Returns how what the nodes before the end and the points lack is changed by so many times the step, in spreads. */
static double change_of(const retrax_search *search, const double *spreads, double size) {
    const retrax_layout *const layout = search->phases->layout;
    static const retrax_array arrays[] = {RETRAX_ARRAY_DEFECTS, RETRAX_ARRAY_POINT_DEFECTS};
    const retrax_index n = layout->problem->state_size;
    const retrax_index counts[] = {layout->problem->steps * n, layout->count[RETRAX_ARRAY_POINT_DEFECTS]};
    double most = 0.0;
    for (retrax_index a = 0; a < n; a++) {
        double changed = 0.0;
        for (int i = 0; i < 2; i++) {
            const retrax_index first = layout->first[arrays[i]];
            for (retrax_index j = a; j < counts[i]; j += n) {
                changed += fabs(search->trial[first + j] - search->at[first + j]);
            }
        }
        if (spreads[a] > 0.0 && changed > RETRAX_ROOT_EPS * size * search->phases->largest[a]) {
            most = fmax(most, changed / spreads[a]);
        }
    }
    return most;
}

/* Returns how many times the step changes what is lacking by half a spread, to second order; 0 where it changes
 * nothing. */
static double bending_size(retrax_search *search) {
    const retrax_layout *const layout = search->phases->layout;
    const double *const trajectory = search->at;
    const retrax_index n = layout->problem->state_size, E = layout->problem->state_numbers;
    double *const spreads = search->phases->work, size = 1.0;
    bool bends = false;
    memset(spreads, 0, sizeof(double) * (size_t)n);
    for (retrax_index e = 0; e < E; e++) {
        const double spread = retrax_piece_of(search, e).spread;
        for (retrax_index a = 0; a < n; a++) {
            spreads[a] = fmax(spreads[a], ARRAY(SUPPORT)[a * E + e] * spread);
        }
    }
    for (int round = 0; round < CORRECTIONS; round++) { /* a square at the second, unless the first is too small */
        move_by(search, size);
        retrax_evaluate_trajectory(layout, search->trial);
        const double change = change_of(search, spreads, size);
        bends = change > 0.0 && isfinite(change);
        size *= bends ? sqrt(MOVED / change) : 1.0;
    }
    return bends ? size : 0.0;
}

/* Whether so many times the step hardly moves a piece that is spread. */
static bool is_held(const retrax_search *search, double size) {
    for (retrax_index e = 0; e < search->phases->layout->problem->state_numbers; e++) {
        const retrax_piece piece = retrax_piece_of(search, e);
        if (piece.spread > 0.0 && size * piece.far <= REACHED * piece.spread) {
            return true;
        }
    }
    return false;
}

/* Moves the iterate, which was evaluated, by a step of waves. held: whether it hardly moves something that is spread.
 * Returns whether nothing that is spread moves or bends. */
static bool perturb(retrax_search *search, const double *draws, bool last, bool *held) {
    const bool finite = find_step(search, draws);
    double size = 0.0, bending = 0.0;
    *held = false;
    if (finite) {
        retrax_find_pieces(search);
        size = typical_size(search);
        bending = bending_size(search);
        retrax_find_pieces(search);
        *held = bending > 0.0 && is_held(search, fmin(size, bending));
        size = *held ? bending : size;
    }
    const bool still = finite && size == 0.0 && !last;
    move_by(search, still ? MOVED : size);
    retrax_swap(search);
    retrax_rest_slacks(search->phases->layout, search->at);
    return still;
}

/* Whether a guess violates inequalities, by its first slacks. */
static bool violates(const retrax_layout *layout, const double *trajectory) {
    for (retrax_index i = 0; i < layout->count[RETRAX_ARRAY_PENALTIES]; i++) {
        if (ARRAY(PENALTIES)[i] < INFINITY) {
            return true;
        }
    }
    return false;
}

bool retrax_search_perturb(retrax_search *search, const double *draws) {
    bool found, held, still;
    if (retrax_is_coupled(search)) {
        return false;
    }
    const bool violated = violates(search->phases->layout, search->at);
    retrax_copy(search->trial, search->at, search->numbers); /* both have the same data */
    retrax_evaluate(search, search->at);
    still = perturb(search, draws, false, &found);
    found = found || still;
    for (int round = 1; round <= CORRECTIONS && still; round++) {
        retrax_evaluate(search, search->at);
        still = perturb(search, draws, round == CORRECTIONS, &held);
    }
    search->options.detect_degenerate = false;
    return found || violated;
}
