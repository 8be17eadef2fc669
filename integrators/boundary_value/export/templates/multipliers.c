/* Time of point r, since the beginning of its trajectory. */
static double point_time(const @name@_trajectory *of, int r) {
    return of->times[r / S] + point_places[r % S] * (of->times[r / S + 1] - of->times[r / S]);
}

/* Writes multipliers that are linear between the points; those that only the first point has stay there. */
static void shift_multipliers(const @name@_trajectory *of, double after, double share, @name@_trajectory *to) {
    int left = 0;
    for (int r = 0; r < N * S; r++) {
        const double time = fmin(after + share * point_time(of, r), of->times[N]);
        while (left < N * S - 2 && point_time(of, left + 1) <= time) {
            left++;
        }
        const double begin = point_time(of, left), end = point_time(of, left + 1);
        const double place = fmin(fmax((time - begin) / (end - begin), 0.0), 1.0);
        for (int c = 0; c < LIMITS; c++) {
            const double *const rows = of->multipliers + left * LIMITS + c;
            to->multipliers[r * LIMITS + c] = rows[0] + place * (rows[LIMITS] - rows[0]);
        }
    }
    for (int g = 0; g < GROUPS; g++) {
        bool alone = true;
        for (int r = 1; r < N * S; r++) {
            for (int c = groups[g]; c < groups[g + 1]; c++) {
                alone = alone && of->multipliers[r * LIMITS + c] == 0.0;
            }
        }
        for (int c = groups[g]; c < groups[g + 1] && alone; c++) {
            to->multipliers[c] = of->multipliers[c];
        }
    }
}
