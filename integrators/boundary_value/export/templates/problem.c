/*
 * @name@: the constants of the problem, and a solve of it by the core of retrax. Written by retrax @version@.
 */
#include "@name@.h"

#include "@name@_functions.h"
#include "retrax_core.h"

#include <math.h>
#include <stdint.h>
#include <string.h>

/* ------------------------------------------------------------------------------------------------- constants */

@constants@

/* ------------------------------------------------------------------------------------------------- memory */

/* Bytes that arrays are aligned to. */
#define ALIGNMENT ((size_t)64)
/* Bytes of the arrays of the gains, and with their elimination. */
#define GAINS_BYTES ((size_t)@gains_bytes@)
#define ROOM_BYTES ((size_t)@room_bytes@)
/* The least pivot, relative, of a linear system that is not singular: eps^0.6. */
#define SMALLEST_PIVOT 4e-10

/* A function of the problem with room for the numbers of a point, the context of `evaluate`. */
typedef struct {
    const @name@_function *function;
    double *in, *out;
} call;

/* The beginning of a workspace; the layout and the search stand behind it. */
typedef struct {
    retrax_problem problem;
    retrax_layout layout;
    const retrax_layout *layouts[1];
    retrax_multiphase phases; /* one, whose ends are not coupled */
    call calls[RETRAX_FUNCTIONS];
    double in[@NAME@_MOST_INPUTS], out[@NAME@_MOST_OUTPUTS];
    double *room; /* of the gains, behind the search */
} head;

/* Evaluates a function at some points. */
static void evaluate(void *context, const retrax_tape_data *data, retrax_index points) {
    const call *const own = context;
    for (retrax_index point = 0; point < points; point++) {
        for (int i = 0; i < own->function->inputs; i++) {
            own->in[i] = data->inputs[data->sources[i][0] + point * data->sources[i][1]];
        }
        own->function->evaluate(own->in, own->out);
        for (int i = 0; i < own->function->outputs; i++) {
            data->outputs[data->targets[i][0] + point * data->targets[i][1]] = own->out[i];
        }
    }
}

/* Writes the problem as the core has it. */
static void write_problem(head *own) {
    own->problem = (retrax_problem){
@problem@
    };
    for (int name = 0; name < RETRAX_FUNCTIONS; name++) {
        if (@name@_functions[name].evaluate != NULL) {
            own->calls[name] = (call){&@name@_functions[name], own->in, own->out};
            own->problem.functions[name] = (retrax_function){evaluate, &own->calls[name]};
        }
    }
}

/* Bytes of something, such that what stands behind it is aligned. */
static size_t aligned(size_t bytes) { return (bytes + ALIGNMENT - 1) & ~(ALIGNMENT - 1); }

/* Iterations that a solve may make, and evaluations that it has made. */
typedef struct {
    int most, evaluations;
} budget;

/* Whether a solve has spent its budget; the first evaluation is that of the guess. */
static bool is_spent(void *context, const retrax_iteration *iteration) {
    budget *const own = context;
    (void)iteration;
    return own->evaluations++ >= own->most;
}

/* Makes a search in a workspace; returns NULL if that is too small. */
static retrax_search *make_search(@name@_workspace *workspace, budget *limit, head **found) {
    const retrax_options options = {
        .tolerance = tolerance, .max_iterations = @NAME@_MAX_ITERATIONS, .width = 1.0, .penalty_scale = 1.0, .detect_degenerate = true,
        .report = limit->most > 0 ? is_spent : NULL, .context = limit};
    unsigned char *const base = (unsigned char *)workspace->numbers;
    size_t used = (ALIGNMENT - (size_t)((uintptr_t)base % ALIGNMENT)) % ALIGNMENT;
    memset(base, 0, sizeof(*workspace));
    if (sizeof(*workspace) < used + aligned(sizeof(head))) {
        return NULL;
    }
    head *const own = *found = (void *)(base + used);
    write_problem(own);
    used += aligned(sizeof(head));
    const size_t of_layout = retrax_layout_memory(&own->problem);
    if (of_layout == 0 || sizeof(*workspace) < used + aligned(of_layout)) {
        return NULL;
    }
    retrax_layout_make(&own->problem, base + used, &own->layout);
    used += aligned(of_layout);
    own->layouts[0] = &own->layout;
    own->phases = (retrax_multiphase){.phases = 1, .layouts = own->layouts};
    const size_t of_search = retrax_search_memory(&own->phases, @NAME@_MAX_ITERATIONS);
    if (of_search == 0 || sizeof(*workspace) < used + aligned(of_search) + ROOM_BYTES) {
        return NULL;
    }
    own->room = (void *)(base + used + aligned(of_search));
    return retrax_search_make(&own->phases, &options, RETRAX_PORTABLE, base + used);
}

/* ------------------------------------------------------------------------------------------------- solve */

#define ARRAY(name) (trajectory + own->layout.first[RETRAX_ARRAY_##name])
/* Copies a field from or to the array of the core with its numbers. */
#define READ(field, name) memcpy((field), ARRAY(name), sizeof(field))
#define WRITE(field, name) memcpy(ARRAY(name), (field), sizeof(field))

/* Whether all numbers are finite. */
static bool are_finite(const double *numbers, size_t count) {
    bool found = true;
    for (size_t i = 0; i < count; i++) {
        found = found && isfinite(numbers[i]);
    }
    return found;
}

/* Whether an input can be solved; it consists of numbers of type double alone. */
static bool is_valid(const @name@_input *input) {
    return are_finite((const double *)(const void *)input, sizeof(*input) / sizeof(double)) && input->horizon > 0.0;
}

/* Writes what is given and the guess. */
static void write_input(const head *own, const @name@_input *input, double *trajectory) {
    for (retrax_index k = 0; k < @NAME@_STEPS; k++) {
        ARRAY(STEP_SIZE)[k] = input->horizon * step_fractions[k];
    }
@write_input@
}

/* Writes the costates in the tangent spaces of the nodes, whose frames are orthonormal. */
static void read_costates(const head *own, const double *trajectory, @name@_output *output) {
    const retrax_index n = own->problem.state_size, numbers = @NAME@_STATE_NUMBERS;
    for (retrax_index k = 0; k <= @NAME@_STEPS; k++) {
        const double *const covector = ARRAY(NODE_COSTATES) + k * numbers;
        for (retrax_index a = 0; a < n; a++) {
            const double *const direction = ARRAY(NODE_FRAMES) + (k * n + a) * numbers;
            double part = 0.0;
            for (retrax_index e = 0; e < numbers; e++) {
                part += direction[e] * covector[e];
            }
            for (retrax_index e = 0; e < numbers; e++) {
                output->costates[k][e] += part * direction[e];
            }
        }
    }
}

@gains@

/* Writes the result of a search. */
static void read_output(const head *own, const retrax_search *search, const @name@_input *input,
                        @name@_output *output) {
    const retrax_search_result found = retrax_search_read(search, 0);
    const double *const trajectory = found.trajectory, *const residuals = ARRAY(RESIDUALS);
    memset(output, 0, sizeof(*output));
    output->iterations = (int)found.iterations;
    output->cost = ARRAY(TOTALS)[0];
    READ(output->states, NODES);
    read_costates(own, trajectory, output);
@read_output@
    output->horizon = @duration@;
    for (retrax_index k = 0; k < @NAME@_STEPS; k++) {
        output->times[k + 1] = output->times[k] + output->horizon * step_fractions[k];
    }
    output->defect = residuals[RETRAX_DEFECT];
    output->stationarity = residuals[RETRAX_STATIONARITY];
    output->violation = fmax(residuals[RETRAX_VIOLATION], residuals[RETRAX_EXCESS]);
    output->complementarity = residuals[RETRAX_COMPLEMENTARITY];
    output->strict_minimum = @strict@;
@read_gains@
}

@name@_status @name@_solve(const @name@_input *input, @name@_output *output, @name@_workspace *workspace) {
    return @name@_solve_within(input, 0, output, workspace);
}

@name@_status @name@_solve_within(const @name@_input *input, int iterations, @name@_output *output,
                                  @name@_workspace *workspace) {
    head *own = NULL;
    budget limit = {iterations, 0};
    memset(output, 0, sizeof(*output));
    if (!is_valid(input)) {
        return output->status = @NAME@_BAD_INPUT;
    }
    retrax_search *const search = make_search(workspace, &limit, &own);
    if (search == NULL) {
        return output->status = @NAME@_BAD_WORKSPACE;
    }
    write_input(own, input, retrax_search_trajectory(search, 0));
    retrax_search_status status = retrax_search_run(search);
    if (status == RETRAX_DEGENERATE) {
        retrax_search_perturb(search, draws);
        status = retrax_search_run(search);
    }
    read_output(own, search, input, output);
    if (retrax_search_read(search, 0).converged) { /* also where the last iteration of a budget has led there */
        return output->status = @NAME@_SOLVED;
    }
    switch (status) {
        case RETRAX_INFEASIBLE:
            output->status = @NAME@_INFEASIBLE;
            break;
        case RETRAX_ITERATION_LIMIT:
        case RETRAX_STOPPED:
            output->status = @NAME@_ITERATION_LIMIT;
            break;
        default:
            output->status = @NAME@_SINGULAR;
            break;
    }
    return output->status;
}
