/*
 * retrax core: the compiled part of retrax, as a C library.
 *
 * C99 and libm. The functions below allocate no memory, keep no state between calls, and use no global
 * variable: the caller owns every array. Two threads may call any of them at the same time, as long as they
 * write to different arrays.
 *
 * Contents
 *   1. Types, status codes and the instruction set of the processor
 *   2. Tapes: functions of a point as lists of scalar instructions, evaluated at many points
 *   3. Dense linear algebra for small matrices
 *   4. Block elimination: the linear system of a Newton step along a trajectory
 *
 * Matrices are stored by rows (C order). Shapes are written as in C: double a[m][n] has m rows.
 */
#ifndef RETRAX_CORE_H
#define RETRAX_CORE_H

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
#define RETRAX_CORE_VERSION 1

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
    RETRAX_BAD_LANES = 6        /* the number of lanes is not a positive multiple of RETRAX_VECTOR */
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

/* Lanes are a multiple of this number: one vector of AVX-512, two of AVX2. */
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
    double *outputs;                    /* array that outputs are written to; it does not overlap inputs */
    retrax_index output_size;           /* its length */
    const retrax_index (*targets)[2];   /* [tape.outputs][2] */
} retrax_tape_data;

/* Returns the name of an instruction, as "MUL_ADD"; NULL for a number that is not a code. The text is static. */
RETRAX_API const char *retrax_tape_instruction_name(int code);

/* Returns RETRAX_OK if retrax_tape_run can run the tape without leaving its arrays: codes, registers, places
 * of inputs and outputs and the form of loops. Takes about as long as running the tape at one point. */
RETRAX_API retrax_status retrax_tape_check(const retrax_tape *tape);

/* Returns RETRAX_OK if retrax_tape_run may be called with these arguments: 0 <= first <= last, inputs and outputs of
 * these points lie in their arrays, and lanes is a positive multiple of RETRAX_VECTOR. */
RETRAX_API retrax_status retrax_tape_check_data(const retrax_tape *tape, const retrax_tape_data *data,
                                                retrax_index first, retrax_index last, retrax_index lanes);

/* Returns the number of lanes that suits this many points: a positive multiple of RETRAX_VECTOR, such that few
 * lanes stay empty and the registers fit the near caches. The registers then take
 * tape.registers * retrax_tape_lanes(tape, points) numbers. */
RETRAX_API retrax_index retrax_tape_lanes(const retrax_tape *tape, retrax_index points);

/* Evaluates a tape at the points first, ..., last - 1.
 *
 * registers: workspace, double [tape.registers][lanes], of any content, which is overwritten; aligned to 64
 * bytes it is fastest. lanes: from retrax_tape_lanes, or any other positive multiple of RETRAX_VECTOR; it
 * changes time and memory, not the numbers. set: from retrax_best_instruction_set, or a lesser set.
 *
 * The tape and the data must have passed their checks: nothing is checked here. NaN and infinity are numbers
 * like any other. */
RETRAX_API void retrax_tape_run(const retrax_tape *tape, const retrax_tape_data *data, retrax_index first,
                                retrax_index last, double *registers, retrax_index lanes,
                                retrax_instruction_set set);

#ifdef __cplusplus
}
#endif

#endif /* RETRAX_CORE_H */
