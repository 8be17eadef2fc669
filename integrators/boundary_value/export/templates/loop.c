/*
 * Runs the controller of @name@ along the states of its first plan, and compares its controls with the controller in
 * Python. The test of the build runs this program.
 */
#include "@name@_controller.h"

#include <math.h>
#include <stdio.h>

/* The largest difference from Python, relative to the largest control: solves end anywhere within their tolerance. */
#define CLOSE @close@

/* Times, measured states, and the controls of the controller in Python. */
enum { SAMPLES = @sample_count@ };
@samples@

static @name@_controller controller;
static @name@_workspace workspace;

int main(void) {
    double control[@NAME@_OWN_CONTROLS], most = 0.0, size = 0.0;
    @name@_begin(&controller);
    for (int k = 0; k < SAMPLES; k++) {
        const @name@_source source = @name@_step(&controller, sample_states[k], sample_times[k], control, &workspace);
        for (int i = 0; i < @NAME@_OWN_CONTROLS; i++) {
            most = fmax(most, fabs(control[i] - sample_controls[k][i]));
            size = fmax(size, fabs(sample_controls[k][i]));
        }
        printf("time %g: source %d after %d iterations\n", sample_times[k], (int)source, controller.output.iterations);
    }
    printf("largest relative difference from Python: %.1e\n", size > 0.0 ? most / size : most);
    const long lost = controller.controls[@NAME@_BY_PLAN] + controller.controls[@NAME@_NO_PLAN];
    return lost == 0 && most <= CLOSE * size ? 0 : 1;
}
