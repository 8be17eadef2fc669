/*
 * The receding horizon controller of @name@: the shift of a trajectory on the manifold, and what to apply after a solve.
 * Written by retrax @version@.
 */
#include "@name@_controller.h"

#include "retrax_core.h"

#include <string.h>

@functions@

enum {
    N = @NAME@_STEPS,
    S = @NAME@_POINTS,
    E = @NAME@_STATE_NUMBERS,
    D = @NAME@_DIMENSION,
    U = @NAME@_CONTROL_NUMBERS,
    M = @control_size@, /* dimension of the manifold of controls */
    J = @through_count@, /* places that the polynomial of a step goes through */
    ROUNDS = 30 /* of Newton's method for a centre, which takes three to five */
};

@constants@

/* The polynomials of a step in charts around its centre, and around its first control. */
typedef struct {
    double centre[E];
    double coordinates[J][D], momenta[J][D];
    double offsets[S][M];
} polynomial;

/* ------------------------------------------------------------------------------------------------- polynomials */

/* Values at a time of the polynomials that are 1 at one place and 0 at all others. */
static void lagrange(const double *places, int count, double time, double *values) {
    for (int i = 0; i < count; i++) {
        values[i] = 1.0;
        for (int j = 0; j < count; j++) {
            values[i] *= j == i ? 1.0 : (time - places[j]) / (places[i] - places[j]);
        }
    }
}

/* Copies two or three points side by side. */
static void join(const double *a, const double *b, const double *c, double *to) {
    memcpy(to, a, sizeof(double) * E);
    memcpy(to + E, b, sizeof(double) * E);
    if (c != NULL) {
        memcpy(to + 2 * E, c, sizeof(double) * E);
    }
}

/* Writes the coordinates of a point in the chart around a centre. */
static void write_coordinates(const double *centre, const double *point, double *coordinates) {
    double in[2 * E];
    join(centre, point, NULL, in);
    chart_coordinates(in, coordinates);
}

/* A point with some coordinates in the chart around a centre: the point, a frame there, and the derivatives of the chart. */
typedef struct {
    double point[E], frame[D][E], derivatives[D][D];
} chart_point;

static void write_chart_point(const double *centre, const double *coordinates, chart_point *to) {
    double in[E + D], out[E + D * E + D * D];
    memcpy(in, centre, sizeof(double) * E);
    memcpy(in + E, coordinates, sizeof(double) * D);
    chart_at(in, out);
    memcpy(to->point, out, sizeof(to->point));
    memcpy(to->frame, out + E, sizeof(to->frame));
    memcpy(to->derivatives, out + E + D * E, sizeof(to->derivatives));
}

/* Writes the covector of a chart that a covector at a point is. */
static void pull(const chart_point *at, const double *covector, double *momentum) {
    for (int a = 0; a < D; a++) {
        momentum[a] = 0.0;
        for (int b = 0; b < D; b++) {
            double part = 0.0;
            for (int e = 0; e < E; e++) {
                part += at->frame[b][e] * covector[e];
            }
            momentum[a] += at->derivatives[b][a] * part;
        }
    }
}

/* Writes the covector at a point that a covector of the chart is there. */
static void push(chart_point *at, const double *momentum, double *covector) {
    retrax_index swaps[D];
    double weights[D], parts[D];
    memcpy(parts, momentum, sizeof(parts));
    retrax_lu_factorise(D, &at->derivatives[0][0], swaps, weights);
    retrax_lu_solve_transposed(D, &at->derivatives[0][0], swaps, parts);
    for (int e = 0; e < E; e++) {
        covector[e] = 0.0;
        for (int b = 0; b < D; b++) {
            covector[e] += at->frame[b][e] * parts[b];
        }
    }
}

@centre@

/* Writes the centre of step k of a trajectory, and the coordinates of what its polynomial goes through. */
static void write_chart(const @name@_trajectory *of, int k, polynomial *to) {
    const double *const points[] = {@points_of_step@};
    @write_centre@;
    for (int j = 0; j < J; j++) {
        write_coordinates(to->centre, points[j], to->coordinates[j]);
    }
}

/* Writes the polynomials of step k of a trajectory. */
static void write_polynomial(const @name@_trajectory *of, int k, polynomial *to) {
    const double *const covectors[] = {@covectors_of_step@};
    write_chart(of, k, to);
    for (int j = 0; j < J; j++) {
        chart_point at;
        write_chart_point(to->centre, to->coordinates[j], &at);
        pull(&at, covectors[j], to->momenta[j]);
    }
    for (int i = 0; i < S; i++) {
        double in[2 * U];
        memcpy(in, of->controls[k][0], sizeof(double) * U);
        memcpy(in + U, of->controls[k][i], sizeof(double) * U);
        control_offset(in, to->offsets[i]);
    }
}

/* Writes the control of step k at a fraction of it. */
static void write_control(const @name@_trajectory *of, const polynomial *own, int k, double place, double *control) {
    double shares[S], in[U + M];
    lagrange(point_places, S, place, shares);
    memcpy(in, of->controls[k][0], sizeof(double) * U);
    for (int a = 0; a < M; a++) {
        in[U + a] = 0.0;
        for (int i = 0; i < S; i++) {
            in[U + a] += shares[i] * own->offsets[i][a];
        }
    }
    control_moved(in, control);
}

/* Writes the state and the costate of a step at a fraction of it. */
static void write_state(const polynomial *own, double place, double *state, double *costate) {
    double shares[J], coordinates[D], momentum[D];
    chart_point at;
    lagrange(through, J, place, shares);
    for (int a = 0; a < D; a++) {
        coordinates[a] = momentum[a] = 0.0;
        for (int j = 0; j < J; j++) {
            coordinates[a] += shares[j] * own->coordinates[j][a];
            momentum[a] += shares[j] * own->momenta[j][a];
        }
    }
    write_chart_point(own->centre, coordinates, &at);
    memcpy(state, at.point, sizeof(at.point));
    push(&at, momentum, costate);
}

/* ------------------------------------------------------------------------------------------------- shift */

/* A place along a trajectory: the step, and the fraction of it. */
typedef struct {
    int step;
    double place;
} place;

static place find_place(const @name@_trajectory *of, double time) {
    int k = 0;
    while (k < N - 1 && of->times[k + 1] <= time) {
        k++;
    }
    return (place){k, (time - of->times[k]) / (of->times[k + 1] - of->times[k])};
}

/* Whether all numbers are finite. */
static bool are_finite(const double *numbers, size_t count) {
    bool found = true;
    for (size_t i = 0; i < count; i++) {
        found = found && isfinite(numbers[i]);
    }
    return found;
}

@write_multipliers@

/* Writes what a trajectory is from a time since its beginning on, over a horizon; behind its end its last point stays. */
static void shift(const @name@_trajectory *of, double after, double horizon, @name@_trajectory *to) {
    const double share = horizon / of->times[N];
    polynomial own;
    int known = -1;
    memset(to, 0, sizeof(*to));
    for (int k = 0; k <= N; k++) {
        to->times[k] = k == 0 ? 0.0 : to->times[k - 1] + horizon * step_fractions[k - 1];
        for (int i = -1; i < (k < N ? S : 0); i++) { /* the node, then the points of its step */
            const double inside = i < 0 ? 0.0 : point_places[i] * (of->times[k + 1] - of->times[k]);
            const place at = find_place(of, fmin(after + share * (of->times[k] + inside), of->times[N]));
            if (at.step != known) {
                known = at.step;
                write_polynomial(of, known, &own);
            }
            if (i < 0) {
                write_state(&own, at.place, to->states[k], to->costates[k]);
            } else {
                write_state(&own, at.place, to->point_states[k][i], to->point_costates[k][i]);
                write_control(of, &own, known, at.place, to->controls[k][i]);
            }
        }
    }
@shift_multipliers@
@clock@
}

/* Writes a trajectory as a guess of the solver; returns whether it is finite. */
static bool write_guess(const @name@_trajectory *from, @name@_guess *to) {
    memset(to, 0, sizeof(*to));
@write_points@
    memcpy(to->controls, from->controls, sizeof(to->controls));
    memcpy(to->costates, from->costates, sizeof(to->costates));
@write_limits@
    return are_finite((const double *)(const void *)to, sizeof(*to) / sizeof(double));
}

/* Writes a guess from a trajectory, for a plan that begins at a time; returns whether something of it is left. */
static bool guess_from(@name@_controller *controller, const @name@_trajectory *from, double time) {
    @name@_input *const input = &controller->input;
    if (!from->known || !(time - from->begin < from->times[N])) {
        return false;
    }
    shift(from, fmax(time - from->begin, 0.0), input->horizon, &controller->shifted);
    return write_guess(&controller->shifted, &input->guess);
}

/* ------------------------------------------------------------------------------------------------- control */

/* Keeps the output of a solve as a trajectory. */
static void keep(const @name@_output *output, double begin, @name@_trajectory *to) {
    to->known = true;
    to->begin = begin;
    memcpy(to->times, output->times, sizeof(to->times));
    memcpy(to->states, output->states, sizeof(to->states));
    memcpy(to->costates, output->costates, sizeof(to->costates));
    memcpy(to->controls, output->solution.controls, sizeof(to->controls));
@keep_points@
@keep_limits@
}

/* Puts the entries of a control inside their bounds. */
static void bound(double *control) {
    for (int i = 0; i < @NAME@_OWN_CONTROLS; i++) {
        control[i] = fmin(fmax(control[i], lowest_control[i]), largest_control[i]);
    }
}

bool @name@_planned_control(const @name@_controller *controller, double time, double control[@NAME@_OWN_CONTROLS]) {
    const @name@_trajectory *const plan = &controller->plan;
    double whole[U];
    polynomial own;
    if (!plan->known) {
        return false;
    }
    const place at = find_place(plan, fmin(fmax(time - plan->begin, 0.0), plan->times[N]));
    write_polynomial(plan, at.step, &own);
    write_control(plan, &own, at.step, at.place, whole);
    memcpy(control, whole, sizeof(double) * @NAME@_OWN_CONTROLS);
    bound(control);
    return true;
}

void @name@_begin(@name@_controller *controller) {
    memset(controller, 0, sizeof(*controller));
    controller->input = @name@_default_input;
}

/* Whether a solve has ended at an iterate with finite numbers. */
static bool has_iterate(const @name@_output *found) {
    return found->status != @NAME@_BAD_INPUT && found->status != @NAME@_BAD_WORKSPACE &&
           are_finite(&found->states[0][0], sizeof(found->states) / sizeof(double)) &&
           are_finite(&found->solution.controls[0][0][0], sizeof(found->solution.controls) / sizeof(double));
}

/* Keeps what a solve has found; returns the source of the control. */
static @name@_source choose(@name@_controller *controller, double time, bool first) {
    const @name@_output *const found = &controller->output;
    const bool solved = found->status == @NAME@_SOLVED, finite = has_iterate(found);
    const bool stopped = found->status == @NAME@_ITERATION_LIMIT && @NAME@_BUDGET > 0 && !first;
    controller->iterate.known = false;
    if (finite && (solved || stopped)) {
        keep(found, time, &controller->iterate);
    }
    if (finite && (solved || (!first && fmax(found->defect, found->violation) <= acceptable))) {
        keep(found, time, &controller->plan);
        return solved ? @NAME@_BY_SOLVE : @NAME@_BY_ITERATE;
    }
    return controller->plan.known ? @NAME@_BY_PLAN : @NAME@_NO_PLAN;
}

@name@_source @name@_step(@name@_controller *controller, const double state[@NAME@_GIVEN_NUMBERS], double time,
                          double control[@NAME@_OWN_CONTROLS], @name@_workspace *workspace) {
    const bool first = !controller->plan.known;
    @name@_input *const input = &controller->input;
    memcpy(input->start, state, sizeof(input->start));
    input->horizon = @plan_horizon@;
@start_time@    if (!guess_from(controller, &controller->iterate, time) && !guess_from(controller, &controller->plan, time)) {
        input->guess = @name@_default_input.guess;
    }
    @name@_solve_within(input, first ? 0 : @NAME@_BUDGET, &controller->output, workspace);
    if (!first && controller->output.iterations > controller->most_iterations) {
        controller->most_iterations = controller->output.iterations;
    }
    const @name@_source source = choose(controller, time, first);
    memset(control, 0, sizeof(double) * @NAME@_OWN_CONTROLS);
    bound(control);
    @name@_planned_control(controller, time + half_hold, control);
    controller->controls[source]++;
    return source;
}
