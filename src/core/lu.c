/* LU factorisation of small dense matrices with scaled partial pivoting. */
#include "kernels.h"

#include <math.h>

/* Weight of a row in the search for a pivot that has nothing but its diagonal: larger than any other. */
#define ONLY_PIVOT 1e300

static void swap_rows(retrax_index columns, double *a, double *b) {
    for (retrax_index j = 0; j < columns; j++) {
        const double held = a[j];
        a[j] = b[j];
        b[j] = held;
    }
}

/* Weights of rows in the search for pivots: the inverse of the largest entry; of a row that has nothing but its
 * diagonal, ONLY_PIVOT. Such a row, as that of a state at rest, gives the pivot of its column: another one would leave
 * rounding where it has zeros, and then nothing is at rest any more. */
static void weigh_rows(retrax_index n, const double *a, double *weights) {
    for (retrax_index i = 0; i < n; i++) {
        const double diagonal = fabs(a[i * n + i]);
        double others = 0.0;
        for (retrax_index j = 0; j < n; j++) {
            const double size = fabs(a[i * n + j]);
            others = j != i && size > others ? size : others;
        }
        weights[i] = others == 0.0 && diagonal > 0.0 ? ONLY_PIVOT : 1.0 / (diagonal > others ? diagonal : others);
    }
}

void retrax_lu_factorise(retrax_index n, double *a, retrax_index *swaps, double *weights) {
    weigh_rows(n, a, weights);
    for (retrax_index k = 0; k < n; k++) {
        retrax_index pivot = k;
        double largest = fabs(a[k * n + k]) * weights[k];
        for (retrax_index i = k + 1; i < n; i++) {
            const double size = fabs(a[i * n + k]) * weights[i];
            if (size > largest) {
                largest = size;
                pivot = i;
            }
        }
        swaps[k] = pivot;
        if (pivot != k) {
            swap_rows(n, a + k * n, a + pivot * n);
            swap_rows(1, weights + k, weights + pivot);
        }
        for (retrax_index i = k + 1; i < n; i++) {
            const double factor = a[i * n + k] / a[k * n + k];
            a[i * n + k] = factor;
            for (retrax_index j = k + 1; factor != 0.0 && j < n; j++) {
                a[i * n + j] -= factor * a[k * n + j];
            }
        }
    }
}

void retrax_lu_solve(retrax_index n, const double *a, const retrax_index *swaps, retrax_index width, double *b,
                     retrax_instruction_set set) {
    const retrax_kernels *const kernels = retrax_kernels_for(set);
    for (retrax_index k = 0; k < n; k++) {
        if (swaps[k] != k) {
            swap_rows(width, b + k * width, b + swaps[k] * width);
        }
    }
    for (retrax_index i = 1; i < n; i++) {
        kernels->subtract_products(1, width, i, b + i * width, width, a + i * n, 1, b, width);
    }
    for (retrax_index i = n - 1; i >= 0; i--) {
        double *const row = b + i * width;
        kernels->subtract_products(1, width, n - 1 - i, row, width, a + i * n + i + 1, 1, row + width, width);
        for (retrax_index j = 0; j < width; j++) {
            row[j] /= a[i * n + i];
        }
    }
}

void retrax_lu_solve_transposed(retrax_index n, const double *a, const retrax_index *swaps, double *x) {
    for (retrax_index k = 0; k < n; k++) {
        x[k] /= a[k * n + k];
        for (retrax_index j = k + 1; j < n; j++) {
            x[j] -= a[k * n + j] * x[k];
        }
    }
    for (retrax_index k = n - 1; k >= 0; k--) {
        for (retrax_index i = k + 1; i < n; i++) {
            x[k] -= a[i * n + k] * x[i];
        }
    }
    for (retrax_index k = n - 1; k >= 0; k--) {
        swap_rows(1, x + k, x + swaps[k]);
    }
}
