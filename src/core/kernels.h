/*
 * Kernels of dense algebra: loops over rows of numbers, compiled for each instruction set.
 *
 * `columns` is a multiple of RETRAX_VECTOR, also where less is used; what is written shares no number with what is read.
 */
#ifndef RETRAX_KERNELS_H
#define RETRAX_KERNELS_H

#include "retrax_core.h"

typedef struct {
    /* y[i][j] -= sum_s f[s][i] x[s][j] for i < rows, j < columns, s < terms; rows of y, f and x are y_width, f_width
     * and x_width numbers apart. */
    void (*subtract_products)(retrax_index rows, retrax_index columns, retrax_index terms, double *y,
                              retrax_index y_width, const double *f, retrax_index f_width, const double *x,
                              retrax_index x_width);
    /* y[j] = a x[j] */
    void (*scale)(retrax_index columns, double *y, double a, const double *x);
    /* y[j] = a x[j] + b z[j] */
    void (*combine)(retrax_index columns, double *y, double a, const double *x, double b, const double *z);
    /* y[i][j] *= a[i] x[j] for i < rows, which are `columns` numbers apart */
    void (*scale_both)(retrax_index rows, retrax_index columns, double *y, const double *a, const double *x);
    /* y[j] = max_i a[i] |x[i][j]| for i < rows, which are `columns` numbers apart, where what is not a number counts as
     * nothing; without a: max_i |x[i][j]| */
    void (*largest)(retrax_index rows, retrax_index columns, double *y, const double *a, const double *x);
    /* sizes[j] = mask[j] |x[j]|, mask being 1 or 0; returns the largest of them that is a number */
    double (*masked_sizes)(retrax_index columns, double *sizes, const double *mask, const double *x);
} retrax_kernels;

/* Returns the kernels for an instruction set, the portable ones if the library has none for it. */
const retrax_kernels *retrax_kernels_for(retrax_instruction_set set);

#endif /* RETRAX_KERNELS_H */
