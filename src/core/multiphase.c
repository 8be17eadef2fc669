/*
 * Multiphase: what couples the ends of trajectories, and the sizes and residuals of trajectories together.
 *
 * The ends that are reached are handed to one function. What it finds becomes the cost of each end of each phase, linear,
 * for all that a phase does by itself; the curvature of these costs and the equations are left to the border.
 */
#include "search.h"

#include <float.h>
#include <math.h>
#include <string.h>

/* Times as far as a trajectory of size one: of more squares overflow, and a derivative is next to zero. */
#define FARTHEST 1e60

/* An array of the coupling of an iterate, where `search` and `iterate` have these names. */
#define COUPLED(name) ((iterate) + search->coupling.first[RETRAX_COUPLED_##name])

/* ---------------------------------------------------------------------------------------------------------- arrays */

retrax_index retrax_place_coupling(const retrax_multiphase *problem, retrax_index numbers, retrax_coupling *coupling) {
    const retrax_index K = problem->phases;
    retrax_index e = 0, Z = 0, p = 0, M = problem->equations, r = problem->equations, A = 0;
    for (retrax_index k = 0; k < K; k++) {
        const retrax_problem *const own = problem->layouts[k]->problem;
        e += 2 * own->state_numbers;
        Z += 2 * own->state_size;
        p += own->parameters;
    }
    for (retrax_index i = 0; i < problem->links; i++) {
        M += problem->link[i].numbers;
        A += problem->link[i].numbers;
        r += problem->link[i].size;
    }
#define RETRAX_COUNT_OF(name, number) coupling->count[RETRAX_COUPLED_##name] = (number);
    RETRAX_COUPLED_ARRAYS(RETRAX_COUNT_OF)
#undef RETRAX_COUNT_OF
    for (int array = 0; array < RETRAX_COUPLED_TOTAL; array++) {
        coupling->first[array] = numbers;
        numbers += coupling->count[array];
    }
    coupling->inputs = coupling->first[RETRAX_COUPLED_CURVATURE] - coupling->first[RETRAX_COUPLED_ENDS];
    coupling->outputs = coupling->first[RETRAX_COUPLED_MOVES] - coupling->first[RETRAX_COUPLED_CURVATURE];
    return retrax_width(numbers);
}

void retrax_take_coupling(retrax_block *block, retrax_coupling *coupling) {
    const retrax_index Z = coupling->count[RETRAX_COUPLED_MOVES], r = coupling->count[RETRAX_COUPLED_VALUES];
    const retrax_index total = Z + Z / 2 + r, width = retrax_width(total + 1);
    const retrax_index places = coupling->inputs + coupling->outputs, first = coupling->first[RETRAX_COUPLED_ENDS];
    retrax_border *const border = &coupling->border;
    coupling->places = retrax_take(block, places, 2, sizeof(retrax_index));
    for (retrax_index i = 0; i < places && coupling->places != NULL; i++) {
        coupling->places[i][0] = first + i;
        coupling->places[i][1] = 0;
    }
    coupling->free_places = retrax_take(block, Z, 1, sizeof(retrax_index));
    coupling->sizes = retrax_take(block, r, 1, sizeof(double));
    coupling->fresh = retrax_take(block, r, 1, sizeof(double));
    retrax_take_front(block, total, width, &border->front);
    border->pivots.divided = retrax_take(block, total, width, sizeof(double));
    border->pivots.order = retrax_take(block, total, 1, sizeof(retrax_index));
    border->scales = retrax_take(block, total, 1, sizeof(double));
    border->solution = retrax_take(block, total, 1, sizeof(double));
    border->work = retrax_take(block, total, 1, sizeof(double));
}

void retrax_take_response(const retrax_layout *layout, retrax_block *block, retrax_response *response) {
    const retrax_index N = layout->problem->steps, n = layout->problem->state_size;
    const retrax_index z = layout->count[RETRAX_ARRAY_PARTS], columns = 1 + 2 * n;
    response->free = retrax_take(block, 2, n, sizeof(retrax_index));
    response->slope = retrax_take(block, N * z, columns, sizeof(double));
    response->defect = retrax_take(block, (N + 1) * n, columns, sizeof(double));
    response->steps = retrax_take(block, N * z, columns, sizeof(double));
    response->multipliers = retrax_take(block, (N + 1) * n, columns, sizeof(double));
    response->end = retrax_take(block, n, columns, sizeof(double));
    response->last = retrax_take(block, z, z, sizeof(double));
    response->weights = retrax_take(block, n, 1, sizeof(double));
    response->ways = retrax_take(block, n, 1, sizeof(double));
    response->least = retrax_take(block, n, 1, sizeof(double));
    response->largest = retrax_take(block, z, 1, sizeof(double));
    response->ones = retrax_take(block, n, 1, sizeof(double));
    response->none = retrax_take(block, n, 1, sizeof(double));
    response->factors = retrax_take(block, columns, 1, sizeof(double));
    response->finite = retrax_take(block, columns, 1, sizeof(unsigned char));
}

/* ------------------------------------------------------------------------------------------------------ evaluation */

/* Writes the point at an end that a trajectory reaches: prescribed entries as they are given. */
static void write_reached(const retrax_layout *layout, const double *trajectory, bool of_end, double *to) {
    const retrax_index E = layout->problem->state_numbers, N = layout->problem->steps;
    const double *const own = of_end ? ARRAY(FINISHES) + (N - 1) * E : ARRAY(BEGINS);
    const double *const given = of_end ? ARRAY(END) : ARRAY(START);
    const double *const prescribed = of_end ? ARRAY(END_ENTRIES) : ARRAY(START_ENTRIES);
    for (retrax_index i = 0; i < E; i++) {
        to[i] = prescribed[i] != 0.0 ? given[i] : own[i];
    }
}

void retrax_evaluate_coupling(const retrax_search *search, double *iterate) {
    const retrax_coupling *const own = &search->coupling;
    const retrax_index(*const places)[2] = (const retrax_index(*)[2])own->places;
    const retrax_tape_data data = {iterate, search->numbers, places, iterate, search->numbers, places + own->inputs};
    double *end = COUPLED(ENDS), *parameters = COUPLED(PARAMETERS);
    EACH_PHASE(phase) {
        const retrax_layout *const layout = phase->layout;
        const double *const trajectory = iterate + phase->place;
        const retrax_index count = layout->count[RETRAX_ARRAY_PARAMETERS];
        retrax_copy(parameters, ARRAY(PARAMETERS), count);
        parameters += count;
        for (int side = 0; side < 2; side++, end += layout->problem->state_numbers) {
            write_reached(layout, trajectory, side == 1, end);
        }
    }
    search->problem->function.evaluate(search->problem->function.context, &data, 1);
    const double *cost = COUPLED(COSTS), *derivative = COUPLED(DERIVATIVES), *slope = COUPLED(SLOPES);
    EACH_PHASE(phase) {
        const retrax_layout *const layout = phase->layout;
        const retrax_index E = layout->problem->state_numbers, n = layout->problem->state_size;
        double *const trajectory = iterate + phase->place, *const costs[] = {ARRAY(START_COST), ARRAY(END_COST)};
        for (int side = 0; side < 2; side++, cost++, derivative += E, slope += n) {
            costs[side][0] = *cost;
            retrax_copy(costs[side] + 1, derivative, E);
            retrax_copy(costs[side] + 1 + E, slope, n);
            memset(costs[side] + 1 + E + n, 0, sizeof(double) * (size_t)(n * n));
        }
    }
}

void retrax_move_coupling(const retrax_search *search, double part, double *iterate) {
    const double *const coordinates = search->at + search->coupling.first[RETRAX_COUPLED_COORDINATES];
    const double *const steps = search->at + search->coupling.first[RETRAX_COUPLED_COORDINATE_STEPS];
    const retrax_index equations = search->problem->equations;
    double *to = COUPLED(MULTIPLIERS);
    for (retrax_index i = 0; i < equations; i++, to++) {
        *to = coordinates[i] + part * steps[i];
    }
    for (retrax_index i = 0, row = equations; i < search->problem->links; i++) {
        const retrax_link *const link = &search->problem->link[i];
        const retrax_phase *const phase = &search->phases[link->target / 2];
        const retrax_layout *const layout = phase->layout;
        const double *const trajectory = search->at + phase->place;
        const retrax_index E = layout->problem->state_numbers, n = layout->problem->state_size;
        const double *const frame = ARRAY(NODE_FRAMES) + (link->target % 2 == 0 ? 0 : layout->problem->steps * n * E);
        for (retrax_index e = 0; e < link->numbers; e++, to++) {
            *to = 0.0;
            for (retrax_index a = 0; a < link->size; a++) {
                *to += (coordinates[row + a] + part * steps[row + a]) * frame[a * E + e];
            }
        }
        row += link->size;
    }
}

/* ------------------------------------------------------------------------------------------------------- residuals */

/* The size of coordinate a of the nodes of a trajectory by its values. */
static double value_of(const retrax_layout *layout, const double *trajectory, retrax_index a) {
    const retrax_index E = layout->problem->state_numbers;
    double found = 0.0;
    for (retrax_index e = 0; e < E; e++) {
        const double value = retrax_larger(ARRAY(HIGHEST)[e], ARRAY(LOWEST)[e]);
        found = retrax_larger(found, ARRAY(SUPPORT)[a * E + e] * value);
    }
    return found;
}

double retrax_largest_curvature(const retrax_search *search, const double *iterate) {
    const double *const curvature = COUPLED(CURVATURE);
    const retrax_index Z = search->coupling.count[RETRAX_COUPLED_MOVES];
    retrax_index first = 0;
    double found = 0.0;
    EACH_PHASE(phase) {
        const retrax_layout *const layout = phase->layout;
        const double *const trajectory = iterate + phase->place;
        const retrax_index n = layout->problem->state_size, z = layout->count[RETRAX_ARRAY_PARTS];
        for (retrax_index i = 0; i < 2 * n; i++) {
            const double own = phase->judging.nodes[i % n];
            const double size = own * retrax_larger(own, RETRAX_VALUE_SHARE * value_of(layout, trajectory, i % n));
            found = retrax_larger(found, fabs(curvature[(first + i) * Z + first + i]) * size);
        }
        for (retrax_index i = 0; i < z && !retrax_has_inequalities(layout->problem); i++) { /* with a barrier it has no bound */
            const double unit = phase->judging.unknowns[i];
            found = retrax_larger(found, ARRAY(CURVATURES)[i] * unit * unit);
        }
        first += 2 * n;
    }
    return found;
}

/* What an equation changes by where both ends of each phase move by sizes of their coordinates: ALONG, the scaling
 * factors of the iterate, or the ways that controls make in free coordinates. */
typedef enum { BY_ALONG, BY_FRESH, BY_WAYS } measure;

static double change_of(const retrax_search *search, const double *iterate, retrax_index equation, measure by) {
    const double *row = COUPLED(JACOBIAN) + equation * search->coupling.count[RETRAX_COUPLED_MOVES];
    double sum = 0.0;
    EACH_PHASE(phase) {
        const retrax_layout *const layout = phase->layout;
        const double *const trajectory = iterate + phase->place;
        const retrax_index n = layout->problem->state_size, N = layout->problem->steps;
        const double *const own = by == BY_FRESH ? phase->fresh.nodes : phase->response.ways;
        const double *const sizes = by == BY_ALONG ? ARRAY(ALONG) : own;
        for (retrax_index i = 0; i < 2 * n; i++, row++) {
            const bool fixed = by == BY_WAYS && ARRAY(FIXED)[i < n ? i : N * n + i - n] != 0.0;
            sum += fixed ? 0.0 : fabs(*row) * sizes[i % n];
        }
    }
    return sum;
}

/* By how much the equations between the ends are missed, relative to what the trajectories change them by. */
static double missed_of(const retrax_search *search, const double *iterate) {
    const double *apart = COUPLED(APART);
    double found = 0.0;
    for (retrax_index i = 0; i < search->problem->equations; i++) {
        const double unit = change_of(search, iterate, i, BY_ALONG);
        found = retrax_larger(found, fabs(COUPLED(VALUES)[i]) / retrax_or_one(unit));
    }
    for (retrax_index i = 0; i < search->problem->links; i++) {
        const retrax_link *const link = &search->problem->link[i];
        const retrax_phase *const phase = &search->phases[link->target / 2];
        const double *const entries = iterate + phase->place + phase->layout->first[RETRAX_ARRAY_ENTRIES];
        for (retrax_index e = 0; e < link->numbers; e++, apart++) {
            found = retrax_larger(found, fabs(*apart) / retrax_or_one(entries[e]));
        }
    }
    return found;
}

/* The most that an equation between the ends lacks, in units of its scaling. */
static double apart_of(const retrax_search *search, const double *iterate) {
    double found = 0.0;
    for (retrax_index i = 0; i < search->coupling.count[RETRAX_COUPLED_VALUES]; i++) {
        found = retrax_larger(found, fabs(COUPLED(VALUES)[i]) / search->coupling.sizes[i]);
    }
    return found;
}

void retrax_join_residuals(const retrax_search *search, double *iterate) {
    double *const residuals = COUPLED(RESIDUALS), *const totals = COUPLED(TOTALS);
    memset(residuals, 0, sizeof(double) * RETRAX_RESIDUALS);
    totals[0] = totals[1] = 0.0;
    EACH_PHASE(phase) {
        const retrax_layout *const layout = phase->layout;
        const double *const trajectory = iterate + phase->place, *const own = ARRAY(RESIDUALS);
        for (int i = 0; i < RETRAX_RESIDUALS; i++) {
            const bool sum = i == RETRAX_INFEASIBILITY || i == RETRAX_BARRIER_OBJECTIVE || i == RETRAX_CONSTRAINT_TERM;
            residuals[i] = sum ? residuals[i] + own[i] : retrax_larger(residuals[i], own[i]);
        }
        totals[0] += ARRAY(TOTALS)[0];
        totals[1] += ARRAY(TOTALS)[1];
    }
    double constraint_term = 0.0;
    for (retrax_index i = 0; i < search->coupling.count[RETRAX_COUPLED_VALUES]; i++) {
        residuals[RETRAX_INFEASIBILITY] += fabs(COUPLED(VALUES)[i]) / search->coupling.sizes[i];
        constraint_term += COUPLED(COORDINATES)[i] * COUPLED(VALUES)[i];
    }
    residuals[RETRAX_CONSTRAINT_TERM] += constraint_term / search->phases->steps.cost;
    residuals[RETRAX_DEFECT] = retrax_larger(residuals[RETRAX_DEFECT], missed_of(search, iterate));
    residuals[RETRAX_MAX_SCALED_DEFECT] = retrax_larger(residuals[RETRAX_MAX_SCALED_DEFECT], apart_of(search, iterate));
    for (int i = RETRAX_ERROR_WITHOUT_COMPLEMENTARITY; i <= RETRAX_BARRIER_ERROR; i++) {
        residuals[i] = retrax_larger(residuals[i], residuals[RETRAX_DEFECT]);
    }
}

/* ----------------------------------------------------------------------------------------------------------- scale */

/* Writes how far controls of a trajectory of size one move the coordinates of its nodes to response.least, 0 where they
 * do not, and there sizes of what nothing moves to response.ways. */
static void find_ways(const retrax_search *search, retrax_phase *phase, double *trajectory) {
    const retrax_layout *const layout = phase->layout;
    const retrax_index n = layout->problem->state_size, z = layout->count[RETRAX_ARRAY_PARTS];
    double *const gradients = search->trial + phase->place + layout->first[RETRAX_ARRAY_STEPS]; /* as many */
    double *const ways = phase->response.ways, *const least = phase->response.least;
    retrax_measure_motion(layout, trajectory, phase->work, phase->sizes, ways);
    for (retrax_index i = 0; i < z; i++) {
        double curvature = 0.0;
        for (retrax_index k = 0; k < layout->problem->steps && i >= n; k++) {
            curvature += fabs(ARRAY(HESSIANS)[(k * z + i) * z + i]);
        }
        phase->sizes[i] = i < n ? 0.0 : 1.0 / sqrt(retrax_or_one(curvature));
        phase->values[i] = DBL_MIN;
        phase->room[i] = INFINITY;
    }
    const retrax_scale_data data = {phase->sizes, phase->values, phase->room, true};
    retrax_copy(gradients, ARRAY(GRADIENTS), layout->count[RETRAX_ARRAY_GRADIENTS]);
    memset(ARRAY(GRADIENTS), 0, sizeof(double) * (size_t)layout->count[RETRAX_ARRAY_GRADIENTS]);
    retrax_measure_scale(layout, trajectory, &data, search->workspace, search->set, &phase->fresh);
    retrax_copy(ARRAY(GRADIENTS), gradients, layout->count[RETRAX_ARRAY_GRADIENTS]);
    for (retrax_index a = 0; a < n; a++) {
        least[a] = phase->fresh.nodes[a] > DBL_MIN ? phase->fresh.nodes[a] : 0.0;
        ways[a] = least[a] > 0.0 ? least[a] : ways[a];
    }
}

/* The size of trajectories whose ends make up for what the equations between them miss. */
static double size_asked(const retrax_search *search, const double *iterate) {
    double asked = 0.0;
    for (retrax_index i = 0; i < search->coupling.count[RETRAX_COUPLED_VALUES]; i++) {
        const double reach = change_of(search, iterate, i, BY_WAYS), value = fabs(COUPLED(VALUES)[i]);
        if (reach > 0.0 && isfinite(reach) && value < FARTHEST * reach) {
            asked = fmax(asked, value / reach);
        }
    }
    return asked;
}

/* The scaling factor of the cost of a whole phase; 0 where it costs nothing. At rest a square has neither a value nor a
 * slope: its curvature is what there is. */
static double cost_of(const retrax_phase *phase, const double *trajectory) {
    static const retrax_array paid[] = {RETRAX_ARRAY_GRADIENTS, RETRAX_ARRAY_COSTS, RETRAX_ARRAY_HESSIANS};
    const retrax_layout *const layout = phase->layout;
    for (size_t k = 0; k < sizeof(paid) / sizeof(paid[0]); k++) {
        for (retrax_index i = 0; i < layout->count[paid[k]]; i++) {
            if (trajectory[layout->first[paid[k]] + i] != 0.0) {
                return phase->fresh.cost * (double)layout->problem->steps;
            }
        }
    }
    return 0.0;
}

void retrax_find_coupled_scales(retrax_search *search, double *iterate) {
    double cost = 0.0, steps = 0.0;
    EACH_PHASE(phase) { find_ways(search, phase, iterate + phase->place); }
    const double asked = size_asked(search, iterate);
    EACH_PHASE(phase) {
        for (retrax_index a = 0; a < phase->layout->problem->state_size; a++) {
            phase->response.least[a] *= asked;
        }
        retrax_find_scale(search, phase, iterate + phase->place, phase->response.least);
        cost = retrax_larger(cost, cost_of(phase, iterate + phase->place));
        steps += (double)phase->layout->problem->steps;
    }
    EACH_PHASE(phase) { phase->fresh.cost = retrax_or_one(cost / steps); }
    for (retrax_index i = 0; i < search->coupling.count[RETRAX_COUPLED_VALUES]; i++) {
        const double size = change_of(search, iterate, i, BY_FRESH);
        search->coupling.fresh[i] = size > 0.0 && isfinite(size) ? size : 1.0;
    }
}
