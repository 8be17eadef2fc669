/*
 * The kernels for one instruction set: kernels.c includes this file once for each, and defines KERNEL(name), the name
 * of a function. TARGET and FUSED are explained in instruction_sets.h.
 */

/* A number of columns, as a multiple of RETRAX_VECTOR that the compiler can derive. */
#define WHOLE(columns) ((columns) & -(retrax_index)RETRAX_VECTOR)
/* The larger of two numbers, y where x is not a number. */
#define LARGER(x, y) ((x) > (y) ? (x) : (y))

/* A vector of y at a time, which stays in registers until all terms are subtracted. The sign belongs to the factor: with
 * it inside of the inner loop gcc makes no vectors. */
TARGET static void KERNEL(subtract_products)(retrax_index rows, retrax_index columns, retrax_index terms, double *y,
                                             retrax_index y_width, const double *f, retrax_index f_width,
                                             const double *x, retrax_index x_width) {
    for (retrax_index i = 0; i < rows; i++) {
        for (retrax_index first = 0; first < columns; first += RETRAX_VECTOR) {
            double *const to = y + i * y_width + first, found[RETRAX_VECTOR];
            for (retrax_index j = 0; j < RETRAX_VECTOR; j++) {
                found[j] = to[j];
            }
            for (retrax_index s = 0; s < terms; s++) {
                const double *const from = x + s * x_width + first, factor = -f[s * f_width + i];
                for (retrax_index j = 0; j < RETRAX_VECTOR; j++) {
                    found[j] = FUSED(factor, from[j], found[j]);
                }
            }
            for (retrax_index j = 0; j < RETRAX_VECTOR; j++) {
                to[j] = found[j];
            }
        }
    }
}

TARGET static void KERNEL(scale)(retrax_index columns, double *y, double a, const double *x) {
    const retrax_index count = WHOLE(columns);
    RETRAX_INDEPENDENT
    for (retrax_index j = 0; j < count; j++) {
        y[j] = a * x[j];
    }
}

TARGET static void KERNEL(combine)(retrax_index columns, double *y, double a, const double *x, double b,
                                   const double *z) {
    const retrax_index count = WHOLE(columns);
    RETRAX_INDEPENDENT
    for (retrax_index j = 0; j < count; j++) {
        y[j] = FUSED(a, x[j], b * z[j]);
    }
}

TARGET static void KERNEL(scale_both)(retrax_index rows, retrax_index columns, double *y, const double *a,
                                      const double *x) {
    const retrax_index count = WHOLE(columns);
    for (retrax_index i = 0; i < rows; i++) {
        double *const row = y + i * columns;
        RETRAX_INDEPENDENT
        for (retrax_index j = 0; j < count; j++) {
            row[j] *= a[i] * x[j];
        }
    }
}

TARGET static void KERNEL(largest)(retrax_index rows, retrax_index columns, double *y, const double *a, const double *x) {
    const retrax_index count = WHOLE(columns);
    memset(y, 0, sizeof(double) * (size_t)columns);
    for (retrax_index i = 0; i < rows; i++) {
        const double *const from = x + i * columns, factor = a == NULL ? 1.0 : a[i];
        RETRAX_INDEPENDENT
        for (retrax_index j = 0; j < count; j++) {
            const double size = factor * fabs(from[j]);
            y[j] = LARGER(size, y[j]);
        }
    }
}

TARGET static double KERNEL(masked_sizes)(retrax_index columns, double *sizes, const double *mask, const double *x) {
    const retrax_index count = WHOLE(columns);
    double a = 0.0, b = 0.0, c = 0.0, d = 0.0; /* the largest of every fourth one */
    RETRAX_INDEPENDENT
    for (retrax_index j = 0; j < count; j++) {
        sizes[j] = mask[j] * fabs(x[j]);
    }
    for (retrax_index j = 0; j < count; j += 4) {
        a = LARGER(sizes[j], a);
        b = LARGER(sizes[j + 1], b);
        c = LARGER(sizes[j + 2], c);
        d = LARGER(sizes[j + 3], d);
    }
    a = LARGER(b, a);
    c = LARGER(d, c);
    return LARGER(c, a);
}

static const retrax_kernels KERNEL(kernels) = {
    KERNEL(subtract_products), KERNEL(scale), KERNEL(combine), KERNEL(scale_both), KERNEL(largest), KERNEL(masked_sizes),
};

#undef WHOLE
#undef LARGER
