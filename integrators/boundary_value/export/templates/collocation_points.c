for (int k = 0; k < N; k++) { /* the points of collocation */
    for (int i = 0; i < S; i++) {
        double in[2 * E + D] = {0.0}, out[2 * E];
        memcpy(in, output->solution.centres[k], sizeof(double) * E);
        for (int j = 0; j < S; j++) {
            for (int a = 0; a < D; a++) {
                in[E + a] += output->horizon * step_fractions[k] * tableau[i][j] * output->solution.velocities[k][j][a];
            }
        }
        memcpy(in + E + D, output->solution.point_costates[k][i], sizeof(double) * E);
        state_at_point(in, out);
        memcpy(to->point_states[k][i], out, sizeof(double) * E);
        memcpy(to->point_costates[k][i], out + E, sizeof(double) * E);
    }
}
