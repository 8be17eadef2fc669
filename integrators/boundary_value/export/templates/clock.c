for (int k = 0; k <= N; k++) { /* the last entry is the time since the beginning */
    to->states[k][E - 1] = to->times[k];
    to->costates[k][E - 1] = 0.0;
    for (int i = 0; i < S && k < N; i++) {
        to->point_states[k][i][E - 1] = to->times[k] + point_places[i] * horizon * step_fractions[k];
        to->point_costates[k][i][E - 1] = 0.0;
    }
}
