for (int k = 0; k < N; k++) {
    const double h = from->times[k + 1] - from->times[k];
    polynomial own;
    write_chart(from, k, &own);
    memcpy(to->centres[k], own.centre, sizeof(own.centre));
    for (int i = 0; i < S; i++) {
        for (int a = 0; a < D; a++) {
            for (int j = 0; j < J; j++) {
                to->velocities[k][i][a] += slopes[i][j] * own.coordinates[j][a] / h;
            }
        }
    }
}
memcpy(to->point_costates, from->point_costates, sizeof(to->point_costates));
