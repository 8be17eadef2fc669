/* Writes the point amid the ends of a step, from a point near to it, by Newton's method until its moves stop shrinking. */
static void find_centre(const double *near, const double *begin, const double *end, double *centre) {
    double last = INFINITY;
    memcpy(centre, near, sizeof(double) * E);
    for (int round = 0; round < ROUNDS; round++) {
        double in[3 * E], out[3 * D * D + 3 * D], transposed[D][D], move[D], weights[D], size = 0.0;
        const double *const jacobian = out + D * D + D, *const values = jacobian + 2 * D * D;
        retrax_index swaps[D];
        chart_point moved;
        join(centre, begin, end, in);
        chart_uneven(in, out);
        for (int a = 0; a < D; a++) {
            move[a] = -values[a];
            for (int b = 0; b < D; b++) {
                transposed[b][a] = jacobian[a * D + b];
            }
        }
        retrax_lu_factorise(D, &transposed[0][0], swaps, weights);
        retrax_lu_solve_transposed(D, &transposed[0][0], swaps, move);
        for (int a = 0; a < D; a++) {
            const double scale = fabs(values[D + a]);
            size = fmax(size, fabs(move[a]) / (scale > 0.0 ? scale : 1.0));
        }
        write_chart_point(centre, move, &moved);
        memcpy(centre, moved.point, sizeof(moved.point));
        if (!(size < last / 2.0)) {
            return;
        }
        last = size;
    }
}
