/*
 * The kernel of dense algebra, for one instruction set: dense.c includes this file once for each, and names the
 * function KERNEL. TARGET and FUSED are explained in instruction_sets.h.
 */

/* y[i][j] -= sum_s f[s][i] x[s][j] for i < rows, j < columns, s < terms; four terms at a time, so that y is read and
 * written once for four. */
TARGET static void KERNEL(retrax_index rows, retrax_index columns, retrax_index terms, double *y, retrax_index y_width,
                          const double *f, retrax_index f_width, const double *x, retrax_index x_width) {
    const retrax_index padded = columns & -(retrax_index)RETRAX_VECTOR; /* what the compiler cannot know */
    for (retrax_index i = 0; i < rows; i++) {
        double *restrict const to = y + i * y_width;
        retrax_index s = 0;
        for (; s + 4 <= terms; s += 4) {
            const double *const x0 = x + s * x_width, *const x1 = x0 + x_width, *const x2 = x1 + x_width,
                                *const x3 = x2 + x_width;
            const double f0 = -f[s * f_width + i], f1 = -f[(s + 1) * f_width + i];
            const double f2 = -f[(s + 2) * f_width + i], f3 = -f[(s + 3) * f_width + i];
            RETRAX_INDEPENDENT
            for (retrax_index j = 0; j < padded; j++) {
                to[j] = FUSED(f3, x3[j], FUSED(f2, x2[j], FUSED(f1, x1[j], FUSED(f0, x0[j], to[j]))));
            }
        }
        for (; s < terms; s++) {
            const double *const from = x + s * x_width;
            const double factor = -f[s * f_width + i];
            RETRAX_INDEPENDENT
            for (retrax_index j = 0; j < padded; j++) {
                to[j] = FUSED(factor, from[j], to[j]);
            }
        }
    }
}
