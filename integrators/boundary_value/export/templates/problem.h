/*
 * @name@: an optimal control problem and its solver, written by retrax @version@ from
 *
 *     @title@
 *
 * @name@_solve allocates no memory, keeps no state between calls and uses no global variable. Two threads may call it at
 * the same time with workspaces of their own. Numbers are of type double.
 *
 * A trajectory has @NAME@_STEPS steps and @NAME@_STEPS + 1 nodes.
 * @method@
 *
 * The entries of points stand in the order of the arrays in Python, each by rows:
 *
@entries@
 */
#ifndef @NAME@_H
#define @NAME@_H

#include <stdbool.h>

#ifdef __cplusplus
extern "C" {
#endif

enum {
@sizes@
};

/* The unknowns of the solver: a guess, and the solution, which is the guess of a warm start. */
typedef struct {
@guess@
} @name@_guess;

/* What a solve is given. States have to lie on their manifold to rounding, as attitude matrices that are orthogonal: that
 * is not checked. */
typedef struct {
    double start[@NAME@_GIVEN_NUMBERS]; /* first state; @free_start@ */
    double end[@NAME@_GIVEN_NUMBERS]; /* last state; @free_end@ */
    double horizon; /* @horizon@ */
@parameters@    @name@_guess guess;
} @name@_input;

/* How a solve has ended. */
typedef enum {
    @NAME@_SOLVED,           /* the first-order conditions hold to the tolerance */
    @NAME@_ITERATION_LIMIT,  /* after the iterations that it may make they do not hold yet */
    @NAME@_SINGULAR,         /* the linear system of a step has no usable solution; another guess may do */
    @NAME@_INFEASIBLE,       /* constraints contradict each other, or the ends, near the guess */
    @NAME@_BAD_INPUT,        /* a number of the input is not finite, or the horizon is not positive */
    @NAME@_BAD_WORKSPACE     /* the workspace is too small for this processor */
} @name@_status;

/* What a solve returns. Unless the status is @NAME@_SOLVED it is the last iterate: do not fly it. With a bad input or
 * workspace all numbers are zero. */
typedef struct {
    @name@_status status;
    int iterations;
    double cost;
    double horizon; /* duration of the trajectory */
    double times[@NAME@_STEPS + 1]; /* of the nodes, from 0 on */
    double states[@NAME@_STEPS + 1][@NAME@_STATE_NUMBERS]; /* at the nodes */
    double costates[@NAME@_STEPS + 1][@NAME@_STATE_NUMBERS]; /* at the nodes, in the tangent spaces there */
    @name@_guess solution; /* the controls, among others; the guess of a next solve */
    /* Residuals, relative to the size of their parts: of the dynamics, of the derivatives of the Lagrangian, of the
     * inequalities, and of multipliers times slacks. */
    double defect, stationarity, violation, complementarity;
@gains_field@    bool strict_minimum; /* whether the second-order conditions hold too */
} @name@_output;

/* Memory that a solve works in, of any content; it may be static. */
typedef struct {
    double numbers[@NAME@_WORKSPACE_BYTES / sizeof(double)];
} @name@_workspace;

/* The input of the solve in Python that this program was written from. Copy it and change what differs; its guess suits
 * problems nearby. */
extern const @name@_input @name@_default_input;

/* Solves the problem; returns the status, as the output has it. */
@name@_status @name@_solve(const @name@_input *input, @name@_output *output, @name@_workspace *workspace);

/* The same with at most so many iterations, for a control loop; 0: @NAME@_MAX_ITERATIONS. */
@name@_status @name@_solve_within(const @name@_input *input, int iterations, @name@_output *output,
                                  @name@_workspace *workspace);

#ifdef __cplusplus
}
#endif

#endif /* @NAME@_H */
