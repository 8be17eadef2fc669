/*
 * Dense linear algebra for the small matrices of a trajectory: a few rows to some dozen.
 *
 * Rows of matrices are `width` numbers apart, a multiple of RETRAX_VECTOR, so that loops over a row are whole vectors;
 * numbers behind the last column are workspace.
 */
#ifndef RETRAX_DENSE_H
#define RETRAX_DENSE_H

#include "kernels.h"
#include "workspace.h"

/* Returns the width of rows with so many columns: the next multiple of RETRAX_VECTOR. */
retrax_index retrax_width(retrax_index columns);

/*
 * A front: a symmetric matrix in rows 0 to rows - 1, of which the first `pivots` are eliminated and the others, the
 * border, get the Schur complement; then `columns` right-hand sides of the same rows. Both triangles are stored.
 */
typedef struct {
    retrax_index rows;     /* of the symmetric matrix */
    retrax_index unknowns; /* so many rows are slopes by unknowns; rows behind them are equations */
    retrax_index columns;  /* right-hand sides, in the columns from `rows` on */
    retrax_index width;    /* retrax_width(rows + columns) */
    double *matrix;        /* [rows][width] */
    double *left;          /* [width] workspace: 1 in the columns of rows that may become pivots, else 0 */
    double *sizes;         /* [width] workspace: sizes of a row's entries */
    double *kept;          /* [rows][width] workspace: rows of the pivots */
    retrax_index *known;   /* [rows] workspace: number of pivots that have been subtracted from a row */
    bool *unstable;        /* [rows] workspace: rows whose pivot is too small beside the border, by now */
} retrax_front;

/* Takes the arrays of a front of at most so many rows from a block. */
void retrax_take_front(retrax_block *block, retrax_index rows, retrax_index width, retrax_front *front);

/* Adds the inertia of another system. */
void retrax_add_inertia(retrax_inertia *to, retrax_inertia own);

/* Whether a symmetric matrix a[m][m], whose rows are `stride` apart, is positive definite with so much more on its
 * diagonal; work: [m][m]. */
bool retrax_is_positive_definite(const double *a, retrax_index m, retrax_index stride, double more, double *work);

/* Factors of the rows that were eliminated from a front: the pivot rows divided by their pivots. */
typedef struct {
    double *divided;     /* [pivots][width], all columns of the front */
    retrax_index *order; /* [pivots] which rows are pivots, in order; the two rows of a 2 x 2 pivot are neighbours; behind
                            them the rows that are left */
    retrax_index count;  /* number of pivots */
} retrax_pivots;

/* Factorises the first `pivots` rows of a front as P' L D L' P with pivots of size one and two, and subtracts them from
 * the border; returns the inertia. guess: an order to try first, [guesses], as of a front like this one; NULL if
 * guesses is 0.
 *
 * At most `most_left` rows are left, with the pivots subtracted from them as from the border: those in which every
 * pivot is small beside the entries of the border, as where the leading block of a regular matrix is singular. They can
 * be eliminated with the border [Duff, Reid, The multifrontal solution of indefinite sparse symmetric linear equations,
 * ACM Trans. Math. Software 9, 1983].
 *
 * Each pivot is chosen such that its entry is about the largest in both its rows (bounded Bunch-Kaufman pivoting),
 * which bounds the factors, so that the smallest pivot shows how close to singular the matrix is [Ashcraft, Grimes,
 * Lewis, Accurate symmetric indefinite linear equation solvers, SIAM J. Matrix Anal. Appl. 20, 1998]. */
retrax_inertia retrax_front_factorise(const retrax_kernels *kernels, retrax_front *front, retrax_index pivots,
                                      retrax_index most_left, const retrax_index *guess, retrax_index guesses,
                                      retrax_pivots *found);

/* Solves for the unknowns that were eliminated from the first `pivots`, of one right-hand side, number `column`.
 *
 * x: [rows], in which the unknowns of the border and of the rows that are left are given and the others are written;
 * work: [pivots]. */
void retrax_front_substitute(const retrax_front *front, retrax_index pivots, const retrax_pivots *found,
                             retrax_index column, double *x, double *work);

#endif /* RETRAX_DENSE_H */
