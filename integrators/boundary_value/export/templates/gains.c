/* Writes how the controls of each step follow the state at its first node, if the rest of the trajectory stays optimal: for
 * each node, the linear system of the steps behind it is solved for moves of the node. Gains stay zero where no controls
 * are left that meet the end. */
static void read_gains(const head *own, const retrax_search_result *found, @name@_output *output) {
    enum { N = @NAME@_STEPS, n = @NAME@_DIMENSION, m = @NAME@_CONTROL_DIMENSION, E = @NAME@_STATE_NUMBERS };
    enum { z = n + @NAME@_POINTS * m };
    const double *const trajectory = found->trajectory;
    double *const slope = own->room, *const defect = slope + N * z * n, *const step = defect + (N + 1) * n * n;
    double *const multipliers = step + N * z * n, *const largest = multipliers + (N + 1) * n * n;
    double *const none = largest + z, *const ones = none + z, *const marks = ones + n;
    memset(slope, 0, sizeof(double) * (size_t)(marks - slope));
    for (int a = 0; a < n; a++) {
        ones[a] = 1.0;
        defect[a * n + a] = -1.0;
    }
    for (int k = 0; k < N; k++) {
        const retrax_block_system system = {
            .stages = N - k, .node_size = n, .stage_size = z, .columns = n, .hessian = ARRAY(HESSIANS) + k * z * z,
            .left = ARRAY(LEFT) + k * n * z, .right = ARRAY(RIGHT) + k * n * z, .slope = slope, .defect = defect,
            .fixed_start = ones, .fixed_end = ARRAY(FIXED) + N * n, .stage_scale = found->steps.unknowns,
            .node_scale = found->steps.nodes, .cost_scale = found->steps.cost, .regularised = none};
        retrax_block_solution solution = {
            .step = step, .multipliers = multipliers, .finite = (void *)marks, .largest_step = largest};
        retrax_block_eliminate(&system, &solution, (unsigned char *)slope + GAINS_BYTES, RETRAX_PORTABLE);
        for (int i = 0; i < z - n && solution.inertia.smallest > SMALLEST_PIVOT; i++) {
            for (int a = 0; a < n; a++) {
                for (int e = 0; e < E; e++) {
                    output->gains[k][i / m][i % m][e] += step[(n + i) * n + a] * ARRAY(NODE_FRAMES)[(k * n + a) * E + e];
                }
            }
        }
    }
}
