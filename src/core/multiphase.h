/*
 * Multiphase: what couples the ends of trajectories, as the files of a search see it.
 */
#ifndef RETRAX_MULTIPHASE_H
#define RETRAX_MULTIPHASE_H

#include "dense.h"
#include "retrax_core.h"
#include "workspace.h"

/* Arrays of a coupling, behind those of the trajectories in the numbers of an iterate, with the number of their entries:
 * K phases, e numbers and Z coordinates of all 2 K ends, p parameters, M multipliers as they are kept, r equations, A
 * numbers by which states that are linked may differ. */
#define RETRAX_COUPLED_ARRAYS(X)                                                                                      \
    /* what the function reads */                                                                                     \
    X(ENDS, e) X(PARAMETERS, p) X(MULTIPLIERS, M)                                                                     \
    /* what it writes */                                                                                              \
    X(CURVATURE, Z *Z) X(SLOPES, Z) X(JACOBIAN, r *Z) X(VALUES, r) X(DERIVATIVES, e) X(APART, A) X(COSTS, 2 * K)      \
    X(COORDINATES, r)                                                                                                 \
    /* Newton step: what the ends move by, and steps of the coordinates of the multipliers */                         \
    X(MOVES, Z) X(COORDINATE_STEPS, r)                                                                                \
    /* of all trajectories together */                                                                                \
    X(RESIDUALS, RETRAX_RESIDUALS) X(TOTALS, 2)

#define RETRAX_COUPLED_NAME_OF(name, count) RETRAX_COUPLED_##name,
typedef enum { RETRAX_COUPLED_ARRAYS(RETRAX_COUPLED_NAME_OF) RETRAX_COUPLED_TOTAL } retrax_coupled_array;
#undef RETRAX_COUPLED_NAME_OF

/* The border: the dense system that is left of all trajectories, T = Z + Z / 2 + r unknowns at most. */
typedef struct {
    retrax_front front;   /* of one right-hand side */
    retrax_pivots pivots;
    double *scales;       /* [T] sizes of the unknowns, then with rows and columns of one size */
    double *solution;     /* [T] */
    double *work;         /* [T] */
} retrax_border;

/* The coupling of a search; arrays stand in the memory of the search. */
typedef struct {
    retrax_index first[RETRAX_COUPLED_TOTAL]; /* place of an array in the numbers of an iterate */
    retrax_index count[RETRAX_COUPLED_TOTAL];
    retrax_index inputs, outputs;             /* numbers that the function reads, and writes */
    retrax_index (*places)[2];                /* [inputs + outputs] places of these */
    retrax_index *free_places;                /* [Z] of the free coordinates among those of all ends */
    double *sizes, *fresh;                    /* [r] scaling factors of the equations; those of the iterate */
    retrax_border border;
} retrax_coupling;

/* How a trajectory follows its ends: Newton's step in column 0, then per unit that a free coordinate of its start moves
 * by, then per unit of a linear cost of what its end moves by. 1 + p + n columns, p free coordinates of the start. */
typedef struct {
    retrax_index columns;    /* 1 + p + n */
    retrax_index *free;      /* [2][n] the free coordinates of start and end */
    retrax_index counts[2];  /* their numbers, p and q */
    retrax_index rows[3];    /* of the border, where those of its start, its end and its forces begin */
    double *slope;           /* [N][z][columns] right-hand sides */
    double *defect;          /* [N + 1][n][columns] */
    double *steps;           /* [N][z][columns] */
    double *multipliers;     /* [N + 1][n][columns] */
    double *end;             /* [n][columns] what the end moves by */
    double *last;            /* [z][z] the Hessian of the last stage without the weight on the end */
    double *weights;         /* [n] on what the end moves by */
    double *ways;            /* [n] how far controls move the coordinates of the nodes, or sizes of these */
    double *least;           /* [n] what these have to move by at least */
    double *largest;         /* [z] steps */
    double *ones;            /* [n] */
    double *none;            /* [n] zeros */
    double *factors;         /* [columns] what the columns are combined with */
    unsigned char *finite;   /* [columns] */
} retrax_response;

/* Writes the places of the arrays of a coupling behind so many numbers of the trajectories; returns the numbers of an
 * iterate. */
retrax_index retrax_place_coupling(const retrax_multiphase *problem, retrax_index numbers, retrax_coupling *coupling);

/* Takes the arrays of a coupling from a block. */
void retrax_take_coupling(retrax_block *block, retrax_coupling *coupling);

/* Takes the arrays of a response from a block. */
void retrax_take_response(const retrax_layout *layout, retrax_block *block, retrax_response *response);

#endif /* RETRAX_MULTIPHASE_H */
