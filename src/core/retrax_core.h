/*
 * retrax core: the compiled part of retrax, as a C library.
 *
 * C99 and libm. The functions below allocate no memory, keep no state between calls, and use no global
 * variable: the caller owns every array. Two threads may call any of them at the same time, as long as they
 * write to different arrays, among them the registers of tapes.
 *
 * Contents
 *   1. Types, status codes and the instruction set of the processor
 *   2. Tapes: functions of a point as lists of scalar instructions, evaluated at many points
 *   3. Dense linear algebra for small matrices
 *   4. Block elimination: the linear system of a Newton step along a trajectory
 *   5. Condensing: the inner unknowns of collocation steps
 *   6. Transcription: from the iterate of a trajectory to the linear system of a Newton step
 *   7. Inequalities
 *   8. Convergence: how far a trajectory is from satisfying its conditions
 *   9. Scaling: scaling factors of a trajectory, free of the units that its problem is written in
 *  10. Search: Newton's method on the conditions of trajectories, whose ends may be coupled
 *  11. Integration: implicit steps of trajectories, many of them side by side
 *
 * Matrices are stored by rows (C order). Shapes are written as in C: double a[m][n] has m rows.
 */
#ifndef RETRAX_CORE_H
#define RETRAX_CORE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#if defined(_WIN32)
#define RETRAX_API __declspec(dllexport)
#elif defined(__GNUC__)
#define RETRAX_API __attribute__((visibility("default")))
#else
#define RETRAX_API
#endif

/* ------------------------------------------------------------------------------------------------------
 * 1. Types, status codes and the instruction set of the processor
 * ------------------------------------------------------------------------------------------------------ */

/* Version of the interface below; it changes whenever a struct or a function does. */
#define RETRAX_CORE_VERSION 7

/* Counts and places in arrays; signed, as wide as a pointer. */
typedef ptrdiff_t retrax_index;

/* Results of the functions that check their input. */
typedef enum {
    RETRAX_OK = 0,
    RETRAX_BAD_SIZE = 1,        /* a count is negative, or an array is missing */
    RETRAX_BAD_INSTRUCTION = 2, /* a code is not in the list of instructions */
    RETRAX_BAD_REGISTER = 3,    /* an operand is not a register, or the result overwrites an operand */
    RETRAX_BAD_PLACE = 4,       /* an input or output lies outside of its array */
    RETRAX_BAD_LOOP = 5,        /* a loop has no beginning, no end, or no whole number of rounds */
    RETRAX_BAD_LANES = 6        /* the number of lanes is neither 1 nor a positive multiple of RETRAX_VECTOR */
} retrax_status;

/* Instruction sets that the machine of tapes is compiled for. Numbers may differ in the last digits between
 * RETRAX_PORTABLE and the others, which round a product and a sum once (fused multiply-add). */
typedef enum { RETRAX_PORTABLE = 0, RETRAX_AVX2 = 1, RETRAX_AVX512 = 2 } retrax_instruction_set;

/* Returns RETRAX_CORE_VERSION as it was when the library was compiled. */
RETRAX_API int retrax_core_version(void);

/* Returns a sentence in English for a status; "unknown status" for any other number. The text is static. */
RETRAX_API const char *retrax_status_message(int status);

/* Returns the best instruction set that both this library and this processor have. Call it once and keep the
 * result: asking the processor may take longer than running a tape. */
RETRAX_API retrax_instruction_set retrax_best_instruction_set(void);

/* ------------------------------------------------------------------------------------------------------
 * 2. Tapes
 *
 * A tape is a function R^inputs -> R^outputs as a list of scalar instructions over numbered registers. The
 * machine runs each instruction at a lane of points at once: the registers of `lanes` points are an array
 * double registers[tape.registers][lanes].
 *
 * Instruction k has the code codes[k], the registers operands[k][0..7] and the number values[k]:
 * operands[k][0] is the register of the result, operands[k][1] and up to six more are the arguments.
 * retrax_tape_instruction_name lists the codes. Besides arithmetic there are
 *
 *   CONST   result = values[k]
 *   INPUT   result = input number values[k]; operands[k][2] is 4 where this and the three instructions
 *           after it read four consecutive inputs, which the machine then moves at once, else 0
 *   OUTPUT  output number values[k] = argument 1; operands[k][2] as for INPUT
 *   STATE   result = argument 1: the first value of a number that a loop changes
 *   LOOP    begins a loop of at most values[k] rounds; loops do not nest
 *   NEXT    result = argument 1: the value of such a number for the next round
 *   REPEAT  ends a round and goes on with instruction values[k], the first behind LOOP, unless all rounds
 *           are done or argument 1 is not zero at every point of the lane
 * ------------------------------------------------------------------------------------------------------ */

/* Entries of a row of operands: the result and at most seven arguments. */
#define RETRAX_OPERANDS 8

/* Lanes are a multiple of this number, one vector of AVX-512 and two of AVX2; or there is one for a single point. */
#define RETRAX_VECTOR 8

/* A tape; all arrays belong to the caller and are only read. */
typedef struct {
    retrax_index instructions;              /* number of instructions */
    retrax_index registers;                 /* number of registers */
    retrax_index inputs;                    /* real numbers that the function takes */
    retrax_index outputs;                   /* real numbers that the function returns */
    const uint8_t *codes;                   /* [instructions] */
    const uint32_t (*operands)[RETRAX_OPERANDS]; /* [instructions][8] */
    const double *values;                   /* [instructions] */
} retrax_tape;

/* Where the numbers of points stand in memory: number i of point s is at numbers[places[i][0] + s places[i][1]].
 * So inputs and outputs are read and written where the caller keeps them, whatever the order of the axes. */
typedef struct {
    const double *inputs;               /* array that inputs are read from */
    retrax_index input_size;            /* its length */
    const retrax_index (*sources)[2];   /* [tape.inputs][2]: place of the first point, distance to the next */
    double *outputs;                    /* array that outputs are written to, at no place that an input is read from */
    retrax_index output_size;           /* its length */
    const retrax_index (*targets)[2];   /* [tape.outputs][2] */
} retrax_tape_data;

/* Returns the name of an instruction, as "MUL_ADD"; NULL for a number that is not a code. The text is static. */
RETRAX_API const char *retrax_tape_instruction_name(int code);

/* Returns RETRAX_OK if retrax_tape_run can run the tape without leaving its arrays: codes, registers, places
 * of inputs and outputs and the form of loops. Takes about as long as running the tape at one point. */
RETRAX_API retrax_status retrax_tape_check(const retrax_tape *tape);

/* Returns RETRAX_OK if retrax_tape_run may be called with these arguments: 0 <= first <= last, inputs and outputs of
 * these points lie in their arrays, and lanes is 1 or a positive multiple of RETRAX_VECTOR. */
RETRAX_API retrax_status retrax_tape_check_data(const retrax_tape *tape, const retrax_tape_data *data,
                                                retrax_index first, retrax_index last, retrax_index lanes);

/* Returns the number of lanes that suits this many points: a positive multiple of RETRAX_VECTOR, such that few
 * lanes stay empty and the registers fit the near caches. The registers then take
 * tape.registers * retrax_tape_lanes(tape, points) numbers. */
RETRAX_API retrax_index retrax_tape_lanes(const retrax_tape *tape, retrax_index points);

/* Evaluates a tape at the points first, ..., last - 1.
 *
 * registers: workspace, double [tape.registers][lanes], of any content, which is overwritten; aligned to 64
 * bytes it is fastest. lanes: from retrax_tape_lanes, or any other positive multiple of RETRAX_VECTOR, or 1; it
 * changes time and memory, not the numbers. set: from retrax_best_instruction_set, or a lesser set.
 *
 * The tape and the data must have passed their checks: nothing is checked here. NaN and infinity are numbers
 * like any other. */
RETRAX_API void retrax_tape_run(const retrax_tape *tape, const retrax_tape_data *data, retrax_index first,
                                retrax_index last, double *registers, retrax_index lanes,
                                retrax_instruction_set set);

/* ------------------------------------------------------------------------------------------------------
 * 3. Dense linear algebra for small matrices
 * ------------------------------------------------------------------------------------------------------ */

/* Factorises a[n][n] in place as P a = L U by Gauss's elimination. A pivot is the entry of its column that is largest
 * in proportion to its row; a row that has nothing but its diagonal is a pivot first. On return the upper triangle is
 * U, and below the diagonal stands L, whose diagonal is 1. swaps: [n], row k was exchanged with row swaps[k] >= k;
 * weights: [n] workspace. A singular matrix has factors that are not finite. */
RETRAX_API void retrax_lu_factorise(retrax_index n, double *a, retrax_index *swaps, double *weights);

/* Solves a x = b in place with the factors of retrax_lu_factorise; b is [n][width], width a multiple of RETRAX_VECTOR. */
RETRAX_API void retrax_lu_solve(retrax_index n, const double *a, const retrax_index *swaps, retrax_index width,
                                double *b, retrax_instruction_set set);

/* Solves a' x = b in place with the same factors; x is [n]. */
RETRAX_API void retrax_lu_solve_transposed(retrax_index n, const double *a, const retrax_index *swaps, double *x);

/* ------------------------------------------------------------------------------------------------------
 * 4. Block elimination
 *
 * A Newton step along a trajectory of N stages and N + 1 nodes has unknowns d_k of the stages (their steps, z numbers
 * each) and c_k of the nodes (their multipliers, n numbers each). With the Lagrangian's Hessians H_k and the Jacobians
 * L_k and R_k of the node equations on either side of a stage they satisfy
 *
 *     (H_k + r S) d_k + L_k' c_k - R_k' c_{k+1} = -slope_k,     k = 0, ..., N - 1
 *     L_k d_k - R_{k-1} d_{k-1}                 = -defect_k,    k = 0, ..., N
 *
 * without L at the last node and without R before the first. At the first and the last node each equation may be
 * replaced by c = 0, which leaves that coordinate of the state free. r S is a regularisation, r >= 0, S diagonal.
 *
 * The matrix is symmetric and indefinite. If it has exactly as many negative eigenvalues as there are node equations,
 * (N + 1) n, and no zero ones, the Hessian is positive definite on the null space of the node equations: the step
 * is a descent direction, and at a solution the trajectory is a strict local minimum (Sylvester's law of inertia).
 *
 * Stage after stage d_k and c_k are eliminated, in order of magnitude N (n + z)^3 operations. A leading block of the matrix
 * may be singular where the matrix is not, as at a focal point of the trajectory up to a node. There rows without a stable
 * pivot are left to the stage behind, at most n of them. Equations that depend on each other are solved where their
 * right-hand sides agree.
 * ------------------------------------------------------------------------------------------------------ */

/* Inertia and conditioning of a symmetric matrix, from the pivots of its factorisation. */
typedef struct {
    retrax_index negative; /* number of negative eigenvalues */
    double smallest;       /* size of the smallest pivot, each row and column being scaled to size one where it comes in;
                              NaN if one is NaN. Beyond eps^0.6 it is more than rounding */
} retrax_inertia;

/* A linear system; all arrays belong to the caller and are only read. */
typedef struct {
    retrax_index stages;       /* N >= 1 */
    retrax_index node_size;    /* n >= 1, equations of a node */
    retrax_index stage_size;   /* z >= 1, unknowns of a stage */
    retrax_index columns;      /* right-hand sides, at least 1 */
    const double *hessian;     /* [N][z][z], symmetric, both triangles */
    const double *left;        /* [N][n][z] */
    const double *right;       /* [N][n][z] */
    const double *slope;       /* [N][z][columns] */
    const double *defect;      /* [N + 1][n][columns] */
    const double *fixed_start; /* [n]: 1, or 0 where the equation of the first node is replaced by c = 0 */
    const double *fixed_end;   /* [n]: the same of the last node */
    const double *stage_scale; /* [z] scaling factors of d; pivots are chosen in these units */
    const double *node_scale;  /* [n] scaling factors of the defects */
    double cost_scale;         /* scaling factor of the cost of a stage */
    double regularisation;     /* r >= 0, in units of cost_scale and stage_scale */
    const double *regularised; /* [z] diagonal of S in the same units */
} retrax_block_system;

/* A solution; all arrays belong to the caller and are overwritten. A column that has a number which is not finite is
 * NaN altogether. */
typedef struct {
    double *step;            /* [N][z][columns]: d */
    double *multipliers;     /* [N + 1][n][columns]: c */
    unsigned char *finite;   /* [columns]: 1 where a column is finite, else 0 */
    double *largest_step;    /* [z]: largest |d_k| of column 0 over the stages; NaN where the column is not finite */
    retrax_inertia inertia;  /* of the matrix */
    double curvature;        /* sum_k d_k' (H_k + r S) d_k of column 0, in units of cost_scale */
    double size;             /* sum_k d_k' S d_k of column 0, in units of stage_scale */
} retrax_block_solution;

/* Returns the bytes of workspace that retrax_block_eliminate needs for a system of these sizes; 0 if a size is less
 * than 1 or the workspace would exceed the address space. */
RETRAX_API size_t retrax_block_workspace(retrax_index stages, retrax_index node_size, retrax_index stage_size,
                                         retrax_index columns);

/* Solves a system. workspace: as many bytes as retrax_block_workspace says, aligned to 64 bytes, of any content. */
RETRAX_API void retrax_block_eliminate(const retrax_block_system *system, retrax_block_solution *solution,
                                       void *workspace, retrax_instruction_set set);

/* ------------------------------------------------------------------------------------------------------
 * 5. Condensing: the inner unknowns of collocation steps
 *
 * A step of a collocation method with s points has the unknowns x (n numbers, its first state in a chart), at each
 * point nu_i (n, velocities in the chart) and u_i (m, controls), and the equations d_i = 0 (n) with multipliers
 * lambda_i. With the step size h, the tableau's matrix A and weights b, the points lie at
 *
 *     xi_i = h sum_j A_ij nu_j          and the step's end at          eta = h sum_j b_j nu_j.
 *
 * Newton's equations of the points determine dnu = M w + nu_0 as functions of what is left, w = (dx, du), z = n + s m
 * numbers. Put into the others they leave a system for block elimination: with T w + t = (dx, dxi, dnu, du) at a point,
 * or (dx, deta) at the ends, the Hessian is the sum of T' H T, the slope of T' (g + H t), and the Jacobians of the node
 * equations are L T and R T. The inertia of the whole matrix is that of the smaller one, with s n more
 * positive and negative eigenvalues for each step.
 * ------------------------------------------------------------------------------------------------------ */

/* Newton's equations of N steps; q = 3 n + m. All arrays belong to the caller and are only read. */
typedef struct {
    retrax_index steps;        /* N >= 1 */
    retrax_index points;       /* s >= 1 of a step */
    retrax_index state_size;   /* n >= 1 */
    retrax_index control_size; /* m >= 0, at each point */
    retrax_index columns;      /* right-hand sides, at least 1 */
    const double *step_size;   /* [N]: h */
    const double *matrix;      /* [s][s]: A */
    const double *weights;     /* [s]: b */
    const double *hessian;     /* [N][s][q][q] of the Lagrangian at a point in (dx, dxi, dnu, du), symmetric */
    const double *jacobian;    /* [N][s][n][q] of d_i */
    const double *slope;       /* [N][s][q][columns]: g */
    const double *defect;      /* [N][s][n][columns]: d_i */
    const double *end_hessian; /* [N][2 n][2 n] in (dx, deta), symmetric */
    const double *end_left;    /* [N][n][2 n] of the equations of the node before a step */
    const double *end_right;   /* [N][n][2 n] of the equations of the node behind it */
    const double *end_slope;   /* [N][2 n][columns] */
} retrax_collocation_system;

/* What condensing leaves, and what it keeps to expand solutions; p = s n. All arrays belong to the caller. Where the
 * equations of a step do not determine its velocities, numbers of the step are not finite. */
typedef struct {
    double *hessian;     /* [N][z][z], both triangles */
    double *left;        /* [N][n][z] */
    double *right;       /* [N][n][z] */
    double *slope;       /* [N][z][columns] */
    double *before;      /* [N][n][columns]: what nu_0 adds to the defect of the node before a step */
    double *after;       /* [N][n][columns]: what it takes from the defect of the node behind it */
    double *factors;     /* [N][p][p]: LU of the derivatives of all d_i by all nu_j */
    retrax_index *swaps; /* [N][p] */
    double *velocities;  /* [N][p][z + columns]: M, then nu_0 */
} retrax_condensed_system;

/* Returns the bytes of workspace for steps of these sizes; 0 if a size is too small or too large. */
RETRAX_API size_t retrax_condensing_workspace(retrax_index points, retrax_index state_size, retrax_index control_size,
                                              retrax_index columns);

/* Condenses the steps first, ..., last - 1. workspace: as retrax_condensing_workspace says, aligned to 64 bytes. */
RETRAX_API void retrax_condense(const retrax_collocation_system *system, retrax_condensed_system *condensed,
                                retrax_index first, retrax_index last, void *workspace, retrax_instruction_set set);

/* Computes velocities and multipliers of the points of the steps first, ..., last - 1 from a solution of the condensed
 * system: step [N][z][columns] and multipliers [N + 1][n][columns] give velocities and lambdas, [N][s][n][columns]. Of
 * `condensed` only factors, swaps and velocities are read, here and in retrax_condense_slope. */
RETRAX_API void retrax_expand(const retrax_collocation_system *system, const retrax_condensed_system *condensed,
                              retrax_index first, retrax_index last, const double *step, const double *multipliers,
                              double *velocities, double *lambdas, void *workspace);

/* Computes derivatives of a function of the points and ends of N steps by the velocities, inner [N][p], and by what is
 * left, outer [N][z], along the condensed equations. slope: [N][s][q]; end_slope: [N][2 n], NULL if it is zero. */
RETRAX_API void retrax_condense_slope(const retrax_collocation_system *system,
                                      const retrax_condensed_system *condensed, const double *slope,
                                      const double *end_slope, double *inner, double *outer);

/* ------------------------------------------------------------------------------------------------------
 * 6. Transcription
 *
 * A trajectory has N steps and N + 1 nodes. Its iterate consists of
 *
 *     x_k       the centre of a step, a point of the manifold (E numbers, n coordinates in a chart),
 *     u_ki      controls at the s points of a step (U numbers, m coordinates),
 *     p_k       covectors at the nodes, the multipliers of the equations of the nodes,
 *
 * and, where the method collocates (s >= 2), of the velocities nu_ki of the points in the chart of the step (n numbers)
 * and of the covectors lambda_ki there. A discretization map (s = 1) has neither.
 *
 * The core knows no manifold and no dynamics. It sees points as rows of numbers, steps as coordinates in charts, and asks
 * functions of the problem for the rest. retrax_evaluate_trajectory evaluates them,
 * retrax_assemble_system makes the linear system of a Newton step of their values, and retrax_move_trajectory makes a part
 * of such a step.
 * ------------------------------------------------------------------------------------------------------ */

/* The functions of a problem, with what they read -> write at one place. Derivatives are at the iterate, by the steps
 * of the unknowns in their charts; "Lagrangian" is the cost with all multipliers. q = 3 n + m, z = n + s m. */
typedef enum {
    /* Discretization map: x, u, h, parameters -> begin [E], finish [E]. Collocation: x, eta -> the same. */
    RETRAX_ENDS,
    /* two points of the manifold -> a point amid them [E] */
    RETRAX_MIDDLE,
    /* node, fixed [n], gap [E], covector [E] -> frame [n][E]; in it, where fixed is 1, defect [n] and multipliers [n];
     * the covector with these multipliers [E] */
    RETRAX_FRAMES,
    /* Discretization map: x, u, the nodes on either side, the covectors there, h, parameters, multipliers of the
     * inequalities [c], index of the node at the end [w] -> Hessian [z][z] and slope [z] of the Lagrangian, left [n][z], right [n][z], gradient [z] of
     * the cost, derivatives [c][z] of the inequalities, both ends in the frames of the nodes [2][n], cost, inequalities
     * [c]. Collocation: x, xi, nu, u, lambda, weight, parameters, multipliers [c] -> Hessian [q][q], slope [q],
     * derivatives [n][q] of the defect, gradient [q], derivatives [c][q], defect [n], cost, inequalities [c], frame
     * [n][E], coordinates of lambda in it [n]. */
    RETRAX_POINTS,
    /* Collocation alone: x, eta, the nodes on either side, the covectors there, and with inequalities or costs
     * at nodes h, parameters, multipliers [d], index of the node at the end [w] -> Hessian [2 n][2 n] and slope [2 n] of
     * the Lagrangian by (dx, deta), left [n][2 n], right [n][2 n], gradient [w][2 n] of the cost of the node at the end,
     * derivatives [d][2 n] of the inequalities, both ends in the frames of the nodes [2][n], that cost [w], inequalities
     * [d] */
    RETRAX_BOTH_ENDS,
    /* Discretization map: x, u, step [z], h, parameters -> x, u. Collocation: x, dx -> x, and the matrix [n][n] that
     * carries velocities from one chart to the other. */
    RETRAX_MOVE,
    /* Collocation alone: u, du -> u */
    RETRAX_MOVE_CONTROLS,
    /* Where the start, or the end, costs something: node, parameters -> cost, its derivative [E], that in the frame of
     * the node [n], its Hessian there [n][n] */
    RETRAX_START_COST,
    RETRAX_END_COST,
    /* Where the controls lie on a manifold that is not flat: u -> frame [m][U] */
    RETRAX_CONTROL_FRAMES,
    RETRAX_FUNCTIONS /* their number */
} retrax_function_name;

/* A function of the problem. `evaluate` reads and writes at `points` places, as retrax_tape_run does with a tape;
 * numbers that it cannot compute are NaN. It is NULL where a problem does not have the function. A function that fails
 * notes that in its context, and writes NaN from then on: no trial with NaN is accepted, and the report of the search,
 * which follows each trial, ends it. */
typedef struct {
    void (*evaluate)(void *context, const retrax_tape_data *data, retrax_index points);
    void *context;
} retrax_function;

/* A tape as a function of the problem: the context of retrax_evaluate_tape. */
typedef struct {
    const retrax_tape *tape;
    double *registers; /* [tape.registers][lanes]; functions of one problem may share them: then one thread may run it */
    retrax_index lanes;
    retrax_instruction_set set;
} retrax_tape_function;

/* Evaluates a retrax_tape_function. */
RETRAX_API void retrax_evaluate_tape(void *context, const retrax_tape_data *data, retrax_index points);

/* Sizes and functions of a transcribed problem. All arrays belong to the caller and are only read. */
typedef struct {
    retrax_index steps;           /* N >= 1 */
    retrax_index points;          /* s: 1 of a discretization map, at least 2 of a collocation method */
    retrax_index state_size;      /* n >= 1: dimension of the manifold */
    retrax_index state_numbers;   /* E >= 1: numbers of a point of the manifold */
    retrax_index control_size;    /* m >= 0 */
    retrax_index control_numbers; /* U >= 0 */
    retrax_index parameters;      /* P >= 0 */
    retrax_index inequalities;    /* c >= 0, at each point; of a discretization map also those at its nodes */
    retrax_index node_inequalities; /* d >= 0, at the end and the beginning of a collocation step, else 0 */
    retrax_index node_costs;      /* w: 1 where each node but the first, at the end of a step, has a cost, else 0 */
    const double *matrix;         /* [s][s] of the tableau about the middle of the step; collocation alone */
    const double *weights;        /* [s] */
    const retrax_index *columns;  /* [E]: column of a matrix that an entry of a state belongs to, in 0, ..., E - 1 */
    const retrax_index *arrays;   /* [E]: array that the entry belongs to, in 0, ..., E - 1 */
    bool curved_controls;         /* whether the controls lie on a manifold that is not flat */
    const retrax_index *control_columns; /* [U] as `columns` and `arrays`, of the controls; NULL where these are flat */
    const retrax_index *control_arrays;
    const double *never_elastic;  /* [c + d]: 1 for a bound of what is free, which no iterate leaves, else 0 */
    retrax_index bounds;          /* inequalities, the first ones, that are straight in the controls */
    bool coupled;                 /* whether START_COST and END_COST are written by what couples the ends; see 10 */
    retrax_function functions[RETRAX_FUNCTIONS];
} retrax_problem;

/* Arrays of a trajectory, with the number of their entries, where v = N s for a collocation method and else 0, p = s n, w
 * costs of a node, and l = N s c + N d inequalities: those of all points, then those of the ends of all steps; g = 1
 * where controls lie on a manifold that is not flat, else 0. */
#define RETRAX_ARRAYS(X)                                                                                              \
    /* given */                                                                                                       \
    X(STEP_SIZE, N) X(PARAMETERS, P) X(START, E) X(END, E) /* prescribed points */                                    \
    X(NODE_INDICES, N *w) /* of the nodes at the ends of the steps: 1, ..., N */                                      \
    X(START_ENTRIES, E) X(END_ENTRIES, E) /* 1 where an entry of them is prescribed, else 0 */                        \
    X(FIXED, (N + 1) * n) /* 1 where an equation of a node counts, else 0 */                                          \
    X(LIMIT_WEIGHTS, l) X(PENALTIES, l) X(BARRIER, 1) /* see 7 */                                                     \
    /* unknowns */                                                                                                    \
    X(CENTRES, N *E) X(VELOCITIES, v *n) X(CONTROLS, N *s *U) X(POINT_COSTATES, v *E) X(COSTATES, (N + 1) * E)        \
    X(SLACKS, l) X(LIMIT_MULTIPLIERS, l) X(EXCESSES, l) /* of the inequalities */                                     \
    /* points and ends of the steps in their charts */                                                                \
    X(POINT_CENTRES, v *E) X(XI, v *n) X(ETA, v / s *n) X(POINT_WEIGHTS, v)                                           \
    /* nodes */                                                                                                       \
    X(BEGINS, N *E) X(FINISHES, N *E) X(NODES, (N + 1) * E) X(GAPS, (N + 1) * E) X(SEEN, (N + 1) * E)                 \
    X(DISTANCE, E) X(LARGEST, E) X(COLUMN_SIZES, 2 * E) X(AMID_ENDS, 2 * E) X(AMID, E)                                \
    X(NODE_FRAMES, (N + 1) * n * E)                                                                                   \
    X(DEFECTS, (N + 1) * n) X(ASKED, (N + 1) * n) X(MULTIPLIERS, (N + 1) * n) X(NODE_COSTATES, (N + 1) * E)           \
    X(TURNED_COSTATES, (N + 1) * E) X(START_COST, 1 + E + n + n * n) X(END_COST, 1 + E + n + n * n)                   \
    /* points of collocation */                                                                                       \
    X(POINT_HESSIANS, v *q *q) X(POINT_SLOPES, v *q) X(POINT_JACOBIANS, v *n *q) X(POINT_GRADIENTS, v *q)             \
    X(POINT_DEFECTS, v *n) X(POINT_COSTS, v) X(POINT_FRAMES, v *n *E) X(POINT_MULTIPLIERS, v *n)                      \
    X(END_HESSIANS, v / s * 4 * n * n) X(END_SLOPES, v / s * 2 * n) X(END_LEFT, v / s * 2 * n * n)                    \
    X(END_RIGHT, v / s * 2 * n * n) X(RIGHT_SLOPES, (l > 0) * v * q) X(BARRIER_SLOPES, (l > 0) * v * q)               \
    X(END_GRADIENTS, v / s * w * 2 * n) X(END_COSTS, v / s * w)                                                       \
    X(NEWTON_SLOPES, (l > 0) * v * q) X(RIGHT_END_SLOPES, (d > 0) * N * 2 * n)                                        \
    X(BARRIER_END_SLOPES, (d > 0) * N * 2 * n) X(NEWTON_END_SLOPES, (d > 0) * N * 2 * n) X(FACTORS, v *n *p)          \
    X(SWAPS, v *n) X(VELOCITY_MAPS, v *n *(z + 1)) X(BEFORE, v / s *n) X(AFTER, v / s *n)                             \
    X(SLOPES_BY_VELOCITIES, v *n) X(GRADIENTS_BY_VELOCITIES, v *n)                                                    \
    /* linear system: slopes of the Lagrangian; right sides with the share of the inequalities, and of the barrier */ \
    X(HESSIANS, N *z *z) X(LEFT, N *n *z) X(RIGHT, N *n *z) X(SLOPES, N *z) X(RIGHT_SIDES, N *z)                      \
    X(BARRIER_SIDES, (l > 0) * N * z) X(NEWTON_SIDES, N *z) X(NEWTON_DEFECTS, (N + 1) * n) X(GRADIENTS, N *z)         \
    X(COSTS, N) X(END_COORDINATES, 2 * N * n) X(LIMITS, l)                                                            \
    X(LIMIT_JACOBIANS, N *s *c *(s > 1 ? q : z) + N * d * 2 * n)                                                      \
    /* what is largest along the trajectory, and how far it is from its conditions: see 8 */                          \
    X(HIGHEST, E) X(LOWEST, E) X(SUPPORT, n *E) X(SUMMED_DEFECTS, n) X(MAX_DEFECTS, n) X(PARTS, z) X(LARGEST_SLOPES, z)          \
    X(CURVATURES, z) X(POINT_SURVEY, RETRAX_POINTS_ROWS * n) X(TOTALS, 2) X(LIMIT_SURVEY, RETRAX_LIMIT_ROWS)          \
    X(ALONG, n) X(ENTRIES, E) X(RESIDUALS, RETRAX_RESIDUALS)                                                          \
    /* Newton step from here, and room for the parts of it that a move makes */                                       \
    X(STEPS, N *z) X(MULTIPLIER_STEPS, (N + 1) * n) X(COVECTOR_STEPS, (N + 1) * n) X(VELOCITY_STEPS, v *n)            \
    X(POINT_MULTIPLIER_STEPS, v *n) X(CENTRES_BEFORE, N *E) X(CONTROLS_BEFORE, N *s *U)                               \
    X(CENTRE_PARTS, N *(s > 1 ? n : z)) X(CONTROL_SUPPORT, g *m *U) X(CONTROL_FRAMES, g *N *s *m *U)                  \
    X(CONTROL_PARTS, v *m) X(CARRIED, v / s *n *n) X(SLACK_STEPS, l) X(LIMIT_MULTIPLIER_STEPS, l)                     \
    X(EXCESS_STEPS, l) X(POINT_STEPS, v *q) X(END_STEPS, (d > 0) * N * 2 * n)                                         \
    X(LIMIT_STEP, RETRAX_STEP_ENTRIES)

#define RETRAX_NAME_OF(name, count) RETRAX_ARRAY_##name,
typedef enum { RETRAX_ARRAYS(RETRAX_NAME_OF) RETRAX_ARRAY_TOTAL } retrax_array;
#undef RETRAX_NAME_OF

/* Where the arrays of a trajectory stand in its memory, and what the functions read and write there. */
typedef struct {
    const retrax_problem *problem;
    retrax_index first[RETRAX_ARRAY_TOTAL]; /* place of the first number of an array */
    retrax_index count[RETRAX_ARRAY_TOTAL]; /* number of its entries */
    retrax_index numbers;                   /* of the memory of a trajectory */
    const retrax_index (*sources[RETRAX_FUNCTIONS])[2];
    const retrax_index (*targets[RETRAX_FUNCTIONS])[2];
} retrax_layout;

/* Returns the name of an array of a trajectory, as "CENTRES"; NULL for a number that is none. The text is static. */
RETRAX_API const char *retrax_array_name(int array);

/* Numbers that a function reads, and writes, at one place. */
RETRAX_API retrax_index retrax_function_inputs(const retrax_problem *problem, retrax_function_name name);
RETRAX_API retrax_index retrax_function_outputs(const retrax_problem *problem, retrax_function_name name);

/* Returns the bytes of memory that a layout needs; 0 if a size is out of bounds or the arrays exceed the address
 * space. */
RETRAX_API size_t retrax_layout_memory(const retrax_problem *problem);

/* Lays out the trajectories of a problem; memory: as retrax_layout_memory says, aligned to 64 bytes. The problem and
 * the memory have to last as long as the layout. */
RETRAX_API void retrax_layout_make(const retrax_problem *problem, void *memory, retrax_layout *layout);

/* Returns the bytes of workspace that the functions below need, aligned to 64 bytes: one workspace serves one thread. 0
 * if a size is out of bounds. */
RETRAX_API size_t retrax_workspace(const retrax_problem *problem);

/* Evaluates the functions of the problem at the unknowns of a trajectory. trajectory: double [layout.numbers], aligned
 * to 64 bytes. */
RETRAX_API void retrax_evaluate_trajectory(const retrax_layout *layout, double *trajectory);

/* The two halves of that: up to the ends and nodes of the steps, and all else, for which a problem that is coupled has
 * START_COST and END_COST by then. */
RETRAX_API void retrax_evaluate_nodes(const retrax_layout *layout, double *trajectory);
RETRAX_API void retrax_evaluate_points(const retrax_layout *layout, double *trajectory);

/* Assembles the linear system of a trajectory that was evaluated and, where there are inequalities, has their share. */
RETRAX_API void retrax_assemble_system(const retrax_layout *layout, double *trajectory, void *workspace,
                                       retrax_instruction_set set);

/* Writes the right-hand sides of the Newton step at the barrier: NEWTON_SIDES, NEWTON_DEFECTS, NEWTON_SLOPES. */
RETRAX_API void retrax_write_right_sides(const retrax_layout *layout, double *trajectory);

/* Expands the Newton step: from STEPS and MULTIPLIER_STEPS to COVECTOR_STEPS, at the ends with the slopes of their
 * costs, which move, and of a collocation method to VELOCITY_STEPS and POINT_MULTIPLIER_STEPS. */
RETRAX_API void retrax_expand_step(const retrax_layout *layout, double *trajectory, void *workspace);

/* Writes the unknowns of a trajectory as those of `from` after a part of the Newton step from there, 0 <= part <= 1. */
RETRAX_API void retrax_move_trajectory(const retrax_layout *layout, const double *from, double part,
                                       double *trajectory);

/* ------------------------------------------------------------------------------------------------------
 * 7. Inequalities
 *
 * At each point of a step, and at its ends, inequalities g <= 0 are made g + s = t with a slack s > 0 and, where an
 * inequality is elastic, an excess t > 0 at the penalty rho t; t = 0 where the penalty is infinite. With the barrier mu
 * and the weight w of a point the cost gets w (rho t - mu log s - mu log t). The multiplier nu and zeta = rho - nu
 * satisfy nu s = mu, zeta t = mu. Slacks, excesses and multipliers are eliminated at each point: with 1 / D = s / nu + t
 * / zeta
 *
 *     dnu = D (g + mu / nu - mu / zeta + J d),
 *
 * which leaves w J' D J in the Hessian and w J' D (g + mu (1 / nu - 1 / zeta)) in the slope, affine in mu. An inequality
 * whose weight is zero is not asked for.
 * ------------------------------------------------------------------------------------------------------ */

/* Scaling factors of the inequalities of a trajectory. */
typedef struct {
    double rate;          /* of the cost per time: unit of the barrier */
    const double *limits; /* [c + d] of the inequalities */
} retrax_limit_scale;

/* Rows of LIMIT_SURVEY. */
enum {
    RETRAX_LIMIT_VIOLATION, /* the largest |g + s - t|, relative to the size of its inequality */
    RETRAX_LIMIT_EXCESS,    /* the largest excess, relative to that */
    RETRAX_LIMIT_PRODUCT,   /* the largest of nu s and zeta t */
    RETRAX_LIMIT_LEAST,     /* the least of them; infinite without inequalities */
    RETRAX_LIMIT_SUMMED_DEFECT,   /* sum of w |g + s - t| / limit */
    RETRAX_LIMIT_POTENTIAL, /* sum of w (rho t - mu log(s / limit) - mu log(t / limit)) */
    RETRAX_LIMIT_CONSTRAINT_TERM, /* sum of w nu (g + s - t) */
    RETRAX_LIMIT_PENALTY_GROWTH,      /* the largest penalty, relative to the first one; 0 where nothing is elastic */
    RETRAX_LIMIT_PENALTY_TOO_SMALL,     /* 1 where a multiplier comes near to its penalty and that may still grow */
    RETRAX_LIMIT_LEFT,      /* the largest excess whose multiplier comes near to the last penalty, relative to limit */
    RETRAX_LIMIT_ROWS       /* their number */
};

/* Entries of LIMIT_STEP. */
enum {
    RETRAX_STEP_PRIMAL, /* fraction of the steps of slacks and excesses that stays inside */
    RETRAX_STEP_DUAL,   /* the same of the steps of the multipliers */
    RETRAX_STEP_AHEAD,  /* derivative of the potential along the whole step */
    RETRAX_STEP_CONSTRAINT_TERM, /* sum of w dnu (g + s - t) */
    RETRAX_STEP_ENTRIES /* their number */
};

/* Adds the share of the inequalities to the Hessians of the points, and writes RIGHT_SLOPES and BARRIER_SLOPES, for a
 * discretization map RIGHT_SIDES and BARRIER_SIDES: the slopes with their share, and what the barrier is multiplied
 * with. Call it between retrax_evaluate_trajectory and retrax_assemble_system. */
RETRAX_API void retrax_add_inequalities(const retrax_layout *layout, double *trajectory);

/* Writes LIMIT_SURVEY. Values are measured by their limit, or by a hundredth of the largest one along the trajectory. */
RETRAX_API void retrax_survey_inequalities(const retrax_layout *layout, double *trajectory,
                                           const retrax_limit_scale *scale);

/* Writes SLACK_STEPS, LIMIT_MULTIPLIER_STEPS and EXCESS_STEPS that belong to the Newton step, and LIMIT_STEP: which
 * fraction of the steps of slacks and excesses stays inside, `share` of the way to the boundary; the same of the steps
 * of the multipliers; the derivative of the potential along the whole step; sum of w dnu (g + s - t). */
RETRAX_API void retrax_step_inequalities(const retrax_layout *layout, double *trajectory, double share);

/* Writes slacks, excesses and multipliers as those of `from` after parts of their steps, the primal ones and the dual
 * ones. Where an inequality is not elastic its multiplier stays within a factor 1e10 of mu / s. */
RETRAX_API void retrax_move_inequalities(const retrax_layout *layout, const double *from, double primal, double dual,
                                         double *trajectory);

/* ------------------------------------------------------------------------------------------------------
 * 8. Convergence: how far a trajectory is from satisfying its conditions
 * ------------------------------------------------------------------------------------------------------ */

/* Rows of POINT_SURVEY, each [n]: of the defects of collocation points, and of the slopes of the Lagrangian by their
 * velocities. */
enum {
    RETRAX_POINTS_OF_STEP,    /* the largest sum of the sizes of the defects of a step */
    RETRAX_POINTS_TOTAL,      /* the sum of all */
    RETRAX_POINTS_OF_POINT,   /* the largest one */
    RETRAX_POINTS_PARTS,      /* the largest sum of the sizes of the parts that cancel in a slope, over the same weight */
    RETRAX_POINTS_SLOPE,      /* the largest slope over the weight of its point */
    RETRAX_POINTS_ROWS        /* their number */
};

/* Entries of RESIDUALS. The first nine are relative to what they are made of. */
enum {
    RETRAX_DEFECT,          /* largest distance between ends of steps that should meet, or defect of the points of a step */
    RETRAX_STATIONARITY,    /* largest derivative of the Lagrangian */
    RETRAX_VIOLATION,       /* of g + s = t */
    RETRAX_EXCESS,          /* of t = 0 */
    RETRAX_COMPLEMENTARITY, /* of nu s = 0 */
    RETRAX_CENTRING,        /* of nu s = mu */
    RETRAX_ERROR_WITHOUT_COMPLEMENTARITY, /* the largest of defect, stationarity and violation, which a lower barrier keeps */
    RETRAX_KKT_ERROR,       /* E_0: the largest of that, excess and complementarity; the error of the problem itself */
    RETRAX_BARRIER_ERROR,   /* E_mu: the largest of that and centring; the error of the problem with its barrier */
    RETRAX_INFEASIBILITY,   /* sum of the defects of all nodes and points and of the violations, in units of the scaling */
    RETRAX_BARRIER_OBJECTIVE, /* cost with its barrier, in its unit */
    RETRAX_CONSTRAINT_TERM, /* sum of the multipliers times the defects and violations, in the unit of the cost */
    RETRAX_MAX_SCALED_DEFECT, /* the largest defect of a node or point in a coordinate, in units of the scaling */
    RETRAX_RESIDUALS        /* their number */
};

/* Scaling factors of a trajectory: those that success is judged by, and those of steps. */
typedef struct {
    const double *judging_nodes;    /* [n] */
    const double *judging_unknowns; /* [z] */
    double least_part;              /* cost that sets the scale of slopes where their parts vanish; 0: their curvature */
    const double *nodes;            /* [n] */
    double cost;
} retrax_residual_scale;

/* Writes what is largest along an assembled trajectory: HIGHEST to CURVATURES and POINT_SURVEY; TOTALS are its cost,
 * and the sum of its multipliers times what is lacking. */
RETRAX_API void retrax_survey_trajectory(const retrax_layout *layout, double *trajectory);

/* Writes ALONG, ENTRIES and RESIDUALS of a trajectory that was surveyed; limits: NULL without inequalities. */
RETRAX_API void retrax_measure_residuals(const retrax_layout *layout, double *trajectory,
                                         const retrax_residual_scale *scale, const retrax_limit_scale *limits);

/* ------------------------------------------------------------------------------------------------------ 9. Scaling:
 * scaling factors of a trajectory, free of the units that its problem is written in
 *
 * A coordinate of the state is measured by what the controls reach in it over the horizon. The cheapest way from rest
 * to a deviation e costs e' G^-1 e / 2 with the Gramian G_{k+1} = A G_k A' + B W B' of the linearised steps, where W is
 * the inverse curvature of the cost in the controls. Both ends are fixed, so the smaller of the Gramians from the start
 * and from the end counts. One factor is left, the size of the trajectory: what controls have to make up for of the
 * ends that a drifting trajectory misses, and what the slope of the cost asks for. No size is next to nothing: not
 * beside what each step makes of the sizes of others, nor beside what costs as much as all others do.
 * ------------------------------------------------------------------------------------------------------ */

/* Scaling factors; the arrays belong to the caller. */
typedef struct {
    double *unknowns; /* [z] of a step */
    double *nodes;    /* [n] */
    double cost;      /* of a step */
} retrax_scale;

/* Of what the scaling factors of a trajectory are made beside its linear system; the arrays are only read. */
typedef struct {
    const double *sizes;  /* [z] what states move by along the trajectory, and sizes of controls */
    const double *values; /* [z] sizes of coordinates that nothing moves */
    const double *room;   /* [s m] how far inequalities let the controls go; infinite where they do not stop them */
    bool curved;          /* whether the curvature of the cost in the controls is more than rounding */
} retrax_scale_data;

/* Writes the scaling factors of an assembled trajectory. */
RETRAX_API void retrax_measure_scale(const retrax_layout *layout, const double *trajectory,
                                     const retrax_scale_data *data, void *workspace,
                                     retrax_instruction_set set, retrax_scale *scale);

/* Writes what each coordinate of the nodes of a surveyed trajectory moves by, 0 where that is rounding, and its size.
 * moved and sizes: [n]; work: [2 E]. Beside the size of its column a motion may be rounding, as the tilt of an attitude
 * that turns about one axis. */
RETRAX_API void retrax_measure_motion(const retrax_layout *layout, const double *trajectory, double *work, double *moved,
                                      double *sizes);

/* ------------------------------------------------------------------------------------------------------
 * 10. Search: Newton's method on the conditions of trajectories
 *
 * A problem is a list of phases, usually of one, whose ends may be coupled: K phases have 2 K ends, the start 2 k and the
 * end 2 k + 1 of phase k. One function of all ends evaluates what they cost and the equations b(ends) = 0 between them,
 * among these links, whose values are differences of states in the frame at the target of a link. The multipliers of the
 * equations are numbers, those of a link a covector at its target.
 * ------------------------------------------------------------------------------------------------------ */

/* A link: the state at an end is an image of that at another one. */
typedef struct {
    retrax_index target;  /* the end at which its covector stands */
    retrax_index size;    /* its equations: dimension of the manifold, whose frame begins that of the target */
    retrax_index numbers; /* of the covector, which begin those of a state at the target */
} retrax_link;

/* Phases and what couples their ends; all arrays belong to the caller and are only read.
 *
 * function: the points at all ends, the parameters of all phases, the multipliers [M] -> by coordinates of all ends, Z
 * in all, curvature [Z][Z] and slope [Z] of the costs with the multipliers times the equations, Jacobian [r][Z], values
 * [r]; derivative of the costs with that by the points [all numbers]; states that are linked minus images, of all links;
 * the cost of each end [2 K]; multipliers in coordinates [r]. It is NULL where one phase has ends that nothing couples;
 * else the problems of all phases are marked as coupled. */
typedef struct {
    retrax_index phases;
    const retrax_layout *const *layouts; /* [phases] */
    retrax_index equations;              /* beside those of links, before these */
    retrax_index links;
    const retrax_link *link;             /* [links] */
    retrax_function function;
} retrax_multiphase;

/* How a search has ended. */
typedef enum {
    RETRAX_GOING_ON,
    RETRAX_CONVERGED,       /* at an extremal */
    RETRAX_SINGULAR,        /* the linear system has no solution that can be used */
    RETRAX_INFEASIBLE,      /* inequalities contradict each other, or the ends */
    RETRAX_DEGENERATE,      /* the guess is one from which Newton's method cannot set out; another one may do */
    RETRAX_ITERATION_LIMIT,
    RETRAX_STOPPED          /* as the report has asked */
} retrax_search_status;

/* What a search tells after each evaluation. */
typedef struct {
    retrax_index number;  /* trials so far, but for the guess */
    double cost;
    double defect, stationarity;
    double regularisation;         /* of the Hessian, relative to its diagonal */
    double fraction;      /* of the step that is tried next */
    bool descends;        /* whether that step has positive curvature */
    double violation;     /* of the inequalities, relative */
    double barrier;       /* relative to its unit; 0 without inequalities */
} retrax_iteration;

/* Options of a search. */
typedef struct {
    double tolerance;            /* of the residuals, relative */
    retrax_index max_iterations; /* at least 1 */
    double width;                /* infeasibility that the funnel lets pass at first; 1 is usual */
    double penalty_scale;        /* times the usual first penalty of excesses; 1 is usual */
    bool detect_degenerate;      /* whether a guess may be called degenerate; else the search sets out from any */
    bool (*report)(void *context, const retrax_iteration *iteration); /* asks to stop by true; NULL: nothing is told */
    void *context;
} retrax_options;

/* A search; its arrays stand in the memory that the caller provides. */
typedef struct retrax_search retrax_search;

/* Returns the bytes of memory of a search with at most so many iterations, 1 to 2^20; 0 if that does not fit. */
RETRAX_API size_t retrax_search_memory(const retrax_multiphase *problem, retrax_index max_iterations);

/* Makes a search in memory of that size and of any content, aligned to 64 bytes. The problem has to last as long as the
 * search. */
RETRAX_API retrax_search *retrax_search_make(const retrax_multiphase *problem, const retrax_options *options,
                                             retrax_instruction_set set, void *memory);

/* Returns the iterate of a phase: write what is given and the unknowns of a guess before a run, and read the solution
 * behind it. */
RETRAX_API double *retrax_search_trajectory(retrax_search *search, retrax_index phase);

/* Returns the multipliers [M] of what couples the ends, of the iterate or of the guess with its first multipliers; to be
 * written and read as the iterate is. */
RETRAX_API double *retrax_search_multipliers(retrax_search *search, bool first);

/* Moves the guess aside: by waves of the controls, and by the states to which these lead to first order. The iterate is
 * the guess with its first multipliers and slacks, as a run leaves it that ends as RETRAX_DEGENERATE. draws: [3][s m]
 * amplitudes of size one, such as normal random numbers. Returns whether a guess that is not degenerate is worth a run
 * from there: where the waves hardly move something that changes along it, or it violates inequalities. No later run
 * calls a guess degenerate. Phases whose ends are coupled are not moved. */
RETRAX_API bool retrax_search_perturb(retrax_search *search, const double *draws);

/* Searches an extremal from the guess. */
RETRAX_API retrax_search_status retrax_search_run(retrax_search *search);

/* What a run has found, of a phase up to `rate`, then of all together; the arrays belong to the search. */
typedef struct {
    const double *trajectory;   /* the last iterate */
    const double *first;        /* the guess with its first multipliers and slacks: the arrays before POINT_CENTRES */
    retrax_scale judging;       /* scaling factors that success was judged by */
    retrax_scale steps;         /* those of steps */
    const double *limits;       /* [c + d] of the inequalities */
    double rate;                /* unit of the barrier */
    const double *residuals;    /* [RETRAX_RESIDUALS] of all trajectories together */
    const double *equations;    /* [r] scaling factors of the equations between the ends; NULL where nothing couples them */
    const double *values;       /* [r] of these equations */
    const double *jacobian;     /* [r][Z] their derivatives by coordinates of all ends */
    retrax_index iterations;
    bool iteration_limit_reached; /* whether it has made as many iterations as it may */
    bool converged;             /* whether the iterate is an extremal */
    bool strict;                /* whether it is a strict minimum: Newton's next step was small, and the Hessian of the
                                 * Lagrangian is positive definite on the null space of the constraints */
    bool legendre_holds;        /* whether its cost is strictly convex in the controls, at each point by itself */
    bool solvable;              /* whether the last step is finite, with a regularisation that is not too large */
    bool infeasible;            /* whether inequalities contradict each other, or the ends */
    bool diverging;              /* whether it is no extremal and the cost falls as if it had no lower bound */
    bool stopped;               /* whether the report has asked to stop, be it in the last iteration */
    bool inertia_correct;       /* where the iteration limit ended the search at no extremal: whether the linear system of
                                 * the iterate has, without a regularisation, the inertia of a minimum; else false */
} retrax_search_result;

/* Returns what the last run has found, with the arrays of a phase. */
RETRAX_API retrax_search_result retrax_search_read(const retrax_search *search, retrax_index phase);

/* What a feasibility phase has found. */
typedef struct {
    retrax_index trials;
    bool feasible;        /* whether the sum of what equations and inequalities lack is within the root of the tolerance */
    bool holds;           /* whether all of them hold, to the tolerance */
    bool stopped;         /* whether the report has asked to stop */
} retrax_feasibility;

/* Searches a feasible trajectory near to the guess, whatever it costs, by at most so many trials: steps that are the
 * least that the equations ask for, each shortened until the infeasibility decreases. It is the iterate then, without
 * multipliers, from which a run may set out. */
RETRAX_API retrax_feasibility retrax_search_restore(retrax_search *search, retrax_index max_trials);

/* ------------------------------------------------------------------------------------------------------
 * 11. Integration: implicit steps of trajectories, many of them side by side
 *
 * A step of an implicit method leads from a state (S numbers) to the next one. It has K substeps, one after the other,
 * each with m equations for m unknowns c in a chart. L trajectories are the lanes of a block; all their numbers are an
 * array double memory[R][L], in which the functions of the method read and write rows.
 *
 * Newton's method solves the equations of all lanes of a block at once, with inverse Jacobians that stay from step to
 * step as long as that takes less time. Errors of earlier predictions correct the prediction of the unknowns.
 * ------------------------------------------------------------------------------------------------------ */

/* The functions of a method, with the rows that they read -> write. */
typedef enum {
    RETRAX_STEP_PREPARE,  /* step size, state -> chart, among it FIRST and SIZES */
    RETRAX_STEP_RESIDUAL, /* unknowns, step size, state, chart -> RESIDUAL */
    RETRAX_STEP_PUSH,     /* the same and a direction [m] -> derivative of the residual along it [m]; see retrax_method */
    RETRAX_STEP_END,      /* unknowns, step size, state, chart -> NEXT_STATE, CONTROL, USABLE */
    RETRAX_STEP_FUNCTIONS /* their number */
} retrax_step_function;

/* Parts of the memory of a block, of some rows each. */
typedef enum {
    RETRAX_ROWS_UNKNOWNS,   /* m */
    RETRAX_ROWS_STEP_SIZE,  /* 1 */
    RETRAX_ROWS_STATE,      /* S */
    RETRAX_ROWS_FIRST,      /* m: prediction of the unknowns */
    RETRAX_ROWS_SIZES,      /* m: scaling factors of the unknowns, more than 0 */
    RETRAX_ROWS_RESIDUAL,   /* m */
    RETRAX_ROWS_NEXT_STATE, /* S */
    RETRAX_ROWS_CONTROL,    /* U */
    RETRAX_ROWS_USABLE,     /* 1: 0 where the end of a substep is not what its equations mean, or not finite */
    RETRAX_STEP_ROWS        /* number of parts */
} retrax_step_rows;

/* An implicit method; all arrays belong to the caller and are only read.
 *
 * Of PUSH, number i of the direction of lane j stands behind the memory, at R L + i P + j, with P = L. With a single
 * lane P = m, and the points that PUSH is evaluated at are m directions of this lane: the distance from one point to the
 * next is 1 for directions and derivatives, 0 for all else that is read. The derivative of residual i is output number
 * i m L + j of an array of its own. */
typedef struct {
    retrax_index lanes;    /* L >= 1 */
    retrax_index substeps; /* K >= 1 */
    retrax_index unknowns; /* m >= 1 of a substep */
    retrax_index states;   /* S >= 0 */
    retrax_index controls; /* U >= 0 of a substep */
    retrax_index rows;     /* R */
    retrax_index first[RETRAX_STEP_ROWS];           /* first row of each part */
    const double *parts;                            /* [K]: fractions of a step that its substeps are */
    const double *small_step_inverse;               /* [m][m] inverse Jacobian of small steps; NULL: not known */
    retrax_function functions[RETRAX_STEP_FUNCTIONS];
    const retrax_index (*sources[RETRAX_STEP_FUNCTIONS])[2]; /* places of the lanes of what functions read, write */
    const retrax_index (*targets[RETRAX_STEP_FUNCTIONS])[2];
} retrax_method;

/* Differences of successive errors that predictions are corrected by. */
#define RETRAX_ORDERS 6

/* Trajectories that begin together, in blocks of L; B = T / L rounded up. All arrays belong to the caller. */
typedef struct {
    retrax_index trajectories; /* T >= 1 */
    const double *step_sizes;  /* [T] */
    double *carry;             /* [S + K U][T]: state, and controls of the last step */
    retrax_index *failed;      /* [T]: -1, or the step at which a trajectory has stopped, where its state stays */
    double *inverses;          /* [B][K][m][m][L]: inverse Jacobians, of any content at first */
    double *spent;             /* [B][K]: chord steps spent on them; infinite at first, and where they are of no use */
    double *differences;       /* [B][K][RETRAX_ORDERS][m][L]: of predictions from solutions; 0 at first */
    retrax_index done;         /* steps made before */
    retrax_index steps;        /* to be made */
    retrax_index phase;        /* steps that were made before of a group that is recorded together, less than `every` */
    retrax_index every;        /* steps of a group, at least 1 */
    retrax_index kept;         /* rows of the carry that are recorded, the last ones */
    double *record;            /* [(phase + steps + every - 1) / every][kept][T]: those rows after each group */
} retrax_integration;

/* Returns the bytes of workspace of a method; 0 if that does not fit the address space. */
RETRAX_API size_t retrax_integration_workspace(const retrax_method *method);

/* Makes the steps of the blocks first, ..., last - 1. Blocks share no number but those of the method: threads may make
 * them at the same time, each with functions and a workspace of its own, aligned to 64 bytes, of any content. */
RETRAX_API void retrax_integrate(const retrax_method *method, const retrax_integration *integration,
                                 retrax_index first, retrax_index last, void *workspace);

#ifdef __cplusplus
}
#endif

#endif /* RETRAX_CORE_H */
