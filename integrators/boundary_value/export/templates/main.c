/*
 * Solves the default problem of @name@ and compares with the solution in Python, then solves it once more from its
 * solution. The test of the build runs this program.
 */
#include "@name@.h"

#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdio.h>

/* The largest difference from Python that is rounding, relative to the largest number. */
#define ROUNDING 1e-9

/* The solution in Python. */
@expected@

/* Static: a workspace may be larger than a stack. */
static @name@_input input;
static @name@_output output;
static @name@_workspace workspace;

/* The largest difference between two arrays, relative to the largest number of the second one. */
static double difference(const double *found, const double *expected, size_t count) {
    double most = 0.0, size = 0.0;
    for (size_t i = 0; i < count; i++) {
        most = fmax(most, fabs(found[i] - expected[i]));
        size = fmax(size, fabs(expected[i]));
    }
    return size > 0.0 ? most / size : most;
}

int main(void) {
    input = @name@_default_input;
    const @name@_status status = @name@_solve(&input, &output, &workspace);
    const size_t numbers = sizeof(expected_states) / sizeof(double);
    const double states = difference(&output.states[0][0], &expected_states[0][0], numbers);
    const double cost = difference(&output.cost, &expected_cost, 1);
    const double horizon = difference(&output.horizon, &expected_horizon, 1);
    printf("status %d after %d iterations, cost %.15g, horizon %.15g\n", (int)status, output.iterations, output.cost,
           output.horizon);
    printf("largest relative difference from Python: states %.1e, cost %.1e, horizon %.1e\n", states, cost, horizon);
    input.guess = output.solution;
    const @name@_status again = @name@_solve(&input, &output, &workspace);
    printf("from the solution: status %d after %d iterations\n", (int)again, output.iterations);
    const bool solved = status == @NAME@_SOLVED && again == @NAME@_SOLVED;
    return solved && states <= ROUNDING && cost <= ROUNDING && horizon <= ROUNDING ? 0 : 1;
}
