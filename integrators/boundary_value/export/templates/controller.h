/*
 * A receding horizon controller for @name@, written by retrax @version@.
 *
 * @name@_begin makes a controller, and @name@_step returns its control for a measured state, once per sample. Both
 * allocate no memory and use no global variable: a controller is one struct, and a loop has one of its own.
 *
 * Each step solves the problem from the measured state, from the trajectory before, which it shifts on the manifold by
 * the time that has passed. It makes at most @NAME@_BUDGET iterations (0: no budget of a controller), but for the first
 * one, which has no trajectory to fall back on.
 */
#ifndef @NAME@_CONTROLLER_H
#define @NAME@_CONTROLLER_H

#include "@name@.h"

#ifdef __cplusplus
extern "C" {
#endif

enum {
    @NAME@_OWN_CONTROLS = @own_controls@, /* numbers of a control that is applied, without slacks of soft constraints */
    @NAME@_BUDGET = @budget@ /* the largest number of iterations of a step */
};

/* The source of a control. */
typedef enum {
    @NAME@_BY_SOLVE,   /* the solution at this sample */
    @NAME@_BY_ITERATE, /* an iterate that is feasible up to the tolerance for it, but not optimal yet */
    @NAME@_BY_PLAN,    /* an earlier trajectory, as the solve at this sample found none that can be used */
    @NAME@_NO_PLAN,    /* no solve has ended with success yet: the control is as near to zero as its bounds allow */
    @NAME@_SOURCES     /* their number */
} @name@_source;

/* A trajectory, with what its interpolation needs. */
typedef struct {
    bool known;
    double begin;                       /* time at which it begins */
    double times[@NAME@_STEPS + 1];     /* of the nodes, since then */
    double states[@NAME@_STEPS + 1][@NAME@_STATE_NUMBERS];
    double costates[@NAME@_STEPS + 1][@NAME@_STATE_NUMBERS];
    double point_states[@NAME@_STEPS][@NAME@_POINTS][@NAME@_STATE_NUMBERS];
    double point_costates[@NAME@_STEPS][@NAME@_POINTS][@NAME@_STATE_NUMBERS];
    double controls[@NAME@_STEPS][@NAME@_POINTS][@NAME@_CONTROL_NUMBERS];
    double multipliers[@NAME@_MULTIPLIERS + 1]; /* the last one is unused */
} @name@_trajectory;

/* A controller. */
typedef struct {
    @name@_input input;          /* change `end` and `parameters` between samples; the steps write all else, with a start
                                    time, the last parameter */
    @name@_output output;        /* of the last solve */
    @name@_trajectory plan;      /* the last solution, or feasible iterate, whose controls are applied */
    @name@_trajectory iterate;   /* what the next solve starts from */
    @name@_trajectory shifted;   /* workspace */
    long controls[@NAME@_SOURCES]; /* numbers of controls by their sources */
    int most_iterations;         /* of a step so far, but for the first one */
} @name@_controller;

/* Makes a controller, with the end and the parameters of the controller in Python, and without a plan. */
void @name@_begin(@name@_controller *controller);

/* Writes the control for a state that is measured at a time, later than that of the step before; returns its source. The
 * control @held@. The status of the solve is in controller->output. */
@name@_source @name@_step(@name@_controller *controller, const double state[@NAME@_GIVEN_NUMBERS], double time,
                          double control[@NAME@_OWN_CONTROLS], @name@_workspace *workspace);

/* Writes the control of the plan at a time, inside its bounds; returns false before there is a plan. */
bool @name@_planned_control(const @name@_controller *controller, double time, double control[@NAME@_OWN_CONTROLS]);

#ifdef __cplusplus
}
#endif

#endif /* @NAME@_CONTROLLER_H */
