/*
 * Degenerate guesses: those from which Newton's method cannot set out.
 *
 * At rest a system without drift is controllable in no direction but those of its controls: the constraints of the guess
 * are dependent, and Newton's step has no bound, or leaves what they ask for. Nor is it known which way round ends come
 * together that are opposite to each other. Of coupled ends it is not asked.
 */
#include "search.h"

#include <math.h>

/* Times its spread: a trajectory is not asked to move by more. */
#define MOST_SPREADS 30.0
/* The cosine of half the arc between ends: of their motion as much is seen from its middle. */
#define OPPOSITE 0.05
/* Share of what the linearised constraints ask for: a step that leaves more solves another problem. */
#define UNMET 1e-3
/* Share of the scaling factors of the nodes: of a guess that lacks less, what a step leaves is rounding. */
#define MET 1e-8

/* Whether two entries belong to one piece of a state: an array, but for entries that have a coordinate of their own. */
static bool are_together(const retrax_search *search, retrax_index e, retrax_index f) {
    const retrax_index *const arrays = search->phases->layout->problem->arrays;
    const bool *const alone = search->phases->constant_norm;
    return e == f || (!alone[e] && !alone[f] && arrays[e] == arrays[f]);
}

void retrax_find_pieces(retrax_search *search) {
    const retrax_layout *const layout = search->phases->layout;
    const double *const trajectory = search->at;
    const retrax_index E = layout->problem->state_numbers;
    for (retrax_index e = 0; e < E; e++) {
        search->phases->constant_norm[e] = retrax_is_alone(ARRAY(SUPPORT), layout->problem->state_size, E, e);
    }
}

retrax_piece retrax_piece_of(const retrax_search *search, retrax_index e) {
    const retrax_layout *const layout = search->phases->layout;
    const double *const trajectory = search->at;
    const retrax_index n = layout->problem->state_size, E = layout->problem->state_numbers;
    retrax_piece piece = {0.0, 0.0, e};
    for (retrax_index f = E; f-- > 0;) {
        if (are_together(search, e, f)) {
            piece.first = f;
            piece.spread = retrax_larger(piece.spread, ARRAY(HIGHEST)[f] + ARRAY(LOWEST)[f]);
            for (retrax_index a = 0; a < n; a++) {
                piece.far = retrax_larger(piece.far, search->phases->largest[a] * ARRAY(SUPPORT)[a * E + f]);
            }
        }
    }
    return piece;
}

/* Whether every piece of the states that is spread along the trajectory is moved by many times that. */
static bool is_far(retrax_search *search) {
    bool spreads = false;
    if (!search->direction.finite) {
        return true;
    }
    retrax_find_pieces(search);
    for (retrax_index e = 0; e < search->phases->layout->problem->state_numbers; e++) {
        const retrax_piece piece = retrax_piece_of(search, e);
        spreads = spreads || piece.spread > 0.0;
        if (piece.spread > 0.0 && !(piece.far > MOST_SPREADS * piece.spread)) {
            return false;
        }
    }
    return spreads;
}

/* Whether the step leaves much of what the linearised constraints ask for. */
static bool is_unmet(const retrax_search *search) {
    const retrax_layout *const layout = search->phases->layout;
    const double *const trajectory = search->at;
    const retrax_index N = layout->problem->steps, n = layout->problem->state_size;
    const retrax_index z = layout->count[RETRAX_ARRAY_PARTS];
    double remaining = 0.0, asked = 0.0;
    for (retrax_index k = 0; k <= N; k++) {
        for (retrax_index a = 0; a < n; a++) {
            double value = ARRAY(NEWTON_DEFECTS)[k * n + a];
            asked = retrax_larger(asked, fabs(value) / search->phases->steps.nodes[a]);
            for (retrax_index i = 0; i < z && k < N; i++) {
                value += ARRAY(LEFT)[(k * n + a) * z + i] * ARRAY(STEPS)[k * z + i];
            }
            for (retrax_index i = 0; i < z && k > 0; i++) {
                value -= ARRAY(RIGHT)[((k - 1) * n + a) * z + i] * ARRAY(STEPS)[(k - 1) * z + i];
            }
            remaining = retrax_larger(remaining, fabs(value * ARRAY(FIXED)[k * n + a]) / search->phases->steps.nodes[a]);
        }
    }
    return asked > MET && !(remaining <= UNMET * asked);
}

/* The length of a defect at a node in units of the scaling. */
static double length_of(const retrax_search *search, const double *defect) {
    double sum = 0.0;
    for (retrax_index a = 0; a < search->phases->layout->problem->state_size; a++) {
        const double own = defect[a] / search->phases->steps.nodes[a];
        sum += own * own;
    }
    return sqrt(sum);
}

/* Whether the ends of two steps are opposite to each other. */
static bool are_opposite(const retrax_search *search) {
    const retrax_layout *const layout = search->phases->layout;
    const double *const trajectory = search->at;
    const retrax_index nodes = layout->problem->steps + 1, n = layout->problem->state_size;
    double widest = 0.0;
    for (retrax_index k = 0; k < nodes; k++) {
        widest = retrax_larger(widest, length_of(search, ARRAY(DEFECTS) + k * n));
    }
    for (retrax_index k = 0; k < nodes; k++) {
        const double gap = length_of(search, ARRAY(DEFECTS) + k * n);
        if (gap > RETRAX_SHARE * widest && length_of(search, ARRAY(ASKED) + k * n) < OPPOSITE * gap) {
            return true;
        }
    }
    return false;
}

bool retrax_is_degenerate(retrax_search *search) {
    const retrax_direction step = search->direction;
    if (retrax_is_coupled(search)) {
        return false;
    }
    if (is_unmet(search) || are_opposite(search)) {
        return true;
    }
    if (!is_far(search)) {
        return false;
    }
    retrax_newton_step(search, RETRAX_LEAST_NORM_REGULARISATION);
    const bool found = is_far(search);
    retrax_newton_step(search, step.regularisation);
    search->direction.descends = step.descends;
    return found;
}
