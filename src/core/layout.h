/*
 * Layout: where the arrays of a trajectory stand, for the files that work on them.
 *
 * All arrays of a trajectory stand in one block of numbers. So a function of the problem reads and writes them where they
 * are, and its places are set once for all trajectories of the problem.
 */
#ifndef RETRAX_LAYOUT_H
#define RETRAX_LAYOUT_H

#include "constants.h"
#include "retrax_core.h"

#include <math.h>
#include <stdbool.h>
#include <string.h>

/* The address of an array of a trajectory, where `layout` and `trajectory` have these names. */
#define ARRAY(name) (trajectory + layout->first[RETRAX_ARRAY_##name])

/* The larger of two numbers; NaN if the second one is. */
static inline double retrax_larger(double a, double b) { return b > a || isnan(b) ? b : a; }

/* A size, or 1 where there is none. */
static inline double retrax_or_one(double size) { return size > 0.0 ? size : 1.0; }

static inline void retrax_copy(double *to, const double *from, retrax_index count) {
    memcpy(to, from, sizeof(double) * (size_t)count);
}

/* Whether numbers are finite. */
static inline bool retrax_is_finite(const double *numbers, retrax_index count) {
    double sum = 0.0; /* 0, or NaN where a number is not finite */
    for (retrax_index i = 0; i < count; i++) {
        sum += 0.0 * numbers[i];
    }
    return sum == 0.0;
}

/* The duration of a trajectory. */
double retrax_duration(const retrax_layout *layout, const double *trajectory);

/* Unknowns of a point that inequalities depend on: (dx, dxi, dnu, du), or of a discretization map (dx, du). */
retrax_index retrax_point_unknowns(const retrax_problem *problem);

/* Whether there are inequalities. */
bool retrax_has_inequalities(const retrax_problem *problem);

/* The inequalities of a point that may be curved in the controls. */
static inline retrax_index retrax_curved_limits(const retrax_problem *problem) {
    return problem->inequalities > problem->bounds ? problem->inequalities - problem->bounds : 0;
}

/* One of the inequalities of a trajectory. */
typedef struct {
    retrax_index limit; /* which of those of a point, from 0 on, or of the ends of a step, from c on */
    retrax_index block; /* the point, or the step */
    retrax_index width; /* unknowns that it depends on: of the point, or (dx, deta) */
    retrax_index first; /* place of its derivatives in LIMIT_JACOBIANS */
    bool at_ends;
} retrax_limit;

retrax_limit retrax_limit_of(const retrax_problem *problem, retrax_index i);

/* The stiffness D of an inequality. */
double retrax_stiffness(const retrax_layout *layout, const double *trajectory, retrax_index i);

/* Whether the method of a problem is a collocation method, and not a discretization map. */
bool retrax_collocates(const retrax_problem *problem);

/* The cost of the start, or of the end, of a trajectory; its derivatives are NULL where there is none. */
typedef struct {
    double value;
    const double *derivative; /* [E] */
    const double *slope;      /* [n] in the frame of the node */
    const double *curvature;  /* [n][n] */
    retrax_index node, step;  /* at which it is, and which ends or begins there */
    const double *end;        /* [n][z] derivative of the node by the unknowns of that step */
    const double *mended;     /* [n] what the velocities that mend the defects of the points move it by; NULL: nothing */
    double sign;              /* of the derivative in the covector of the node: 1 at the end, -1 at the start */
} retrax_end_cost;

/* Returns the cost of the end of an evaluated trajectory, or of its start. */
retrax_end_cost retrax_end_cost_of(const retrax_layout *layout, const double *trajectory, bool of_end);

/* Adds the derivatives of the costs of the ends, times a sign, to covectors [N + 1][E] of the nodes. */
void retrax_turn_covectors(const retrax_layout *layout, const double *trajectory, double sign, double *covectors);

/* Evaluates a function at `points` places of a trajectory. */
void retrax_evaluate_function(const retrax_layout *layout, double *trajectory, retrax_function_name name,
                              retrax_index points);

/* Instead of a point: the ends of a step. */
#define RETRAX_AT_ENDS (-1)

/* condensing.c: writes (dx, dxi, dnu, du) of a point of step k of collocation, or (dx, deta) of its ends, of column j of its
 * solution: step [z][columns] and velocities [p][columns] of this step. */
void retrax_write_place(const retrax_collocation_system *system, retrax_index k, retrax_index point, retrax_index j,
                        const double *step, const double *velocities, double *to);

/* Bytes of workspace of retrax_measure_scale; 0 if it exceeds the address space. */
size_t retrax_scaling_workspace(const retrax_problem *problem);

#endif /* RETRAX_LAYOUT_H */
