/*
 * Newton's method for the equations of a substep, in all lanes of a block at once.
 */
#ifndef RETRAX_CHORD_NEWTON_H
#define RETRAX_CHORD_NEWTON_H

#include "workspace.h"

/* The block at hand: its numbers in units of their own, flags of the lanes, being 1 or 0, and what is kept of it. */
typedef struct {
    const retrax_method *method;
    retrax_index lanes, unknowns; /* L and m */
    double *memory;               /* [R][L], then the directions */
    double *scaled;               /* [m][L] unknowns in units of their sizes */
    double *units;                /* [m][L] inverse sizes */
    double *change;               /* [m][L] Newton step in the same units */
    double *unmoved, *changed;    /* [m][L] the step at the unknowns, and by how much it changes beside them */
    double *length, *step;        /* [L] largest entry of the Newton step, and of the last one */
    double *chords;               /* [L] steps with the last Jacobian */
    double *order;                /* [L] of a prediction */
    double *taken, *going, *converged, *good; /* [L] */
    double *controls;             /* [K][U][L] of the substeps */
    double *weights;              /* [m][L] largest entries of rows */
    retrax_index *pivots;         /* [m][L] */
    double *inverse;              /* [m][m][L] of the substep at hand */
    double *differences;          /* [RETRAX_ORDERS][m][L] */
    double *spent;                /* [1] */
} retrax_lanes;

/* Lays out the arrays of a workspace in a block of memory; those that are kept from step to step are set later. */
retrax_lanes retrax_lay_out_lanes(const retrax_method *method, retrax_block *block);

/* Returns the first number of a part of the memory. */
double *retrax_rows_of(const retrax_lanes *own, retrax_step_rows part);

/* Evaluates a function of the method at so many points; it writes to the memory, or PUSH to an array of its own. */
void retrax_evaluate_step(const retrax_lanes *own, retrax_step_function name, double *outputs, retrax_index points);

/* Solves the equations of a substep in all good lanes: with old inverse Jacobians, which are tried for speed alone,
 * with those of small steps, then with new ones. Writes the unknowns, and which lanes have converged. */
void retrax_solve_substep(const retrax_lanes *own);

#endif /* RETRAX_CHORD_NEWTON_H */
