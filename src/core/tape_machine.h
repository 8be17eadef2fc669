/*
 * The machine of tapes, for one instruction set: tape.c includes this file once for each, and names the function
 * MACHINE. TARGET and FUSED are explained in instruction_sets.h.
 *
 * Loops over lanes are plain, and their length is a multiple of RETRAX_VECTOR that the compiler can derive: so it
 * turns each into vector instructions without a remainder. Lanes behind the last point hold arbitrary numbers.
 */

/* Pointer to the lanes of argument i of the instruction at hand, 0 being its result. */
#define LANES_OF(i) (registers + (retrax_index)tape->operands[k][i] * lanes)
/* The instruction, and of a single point those behind it that are the same: there to choose takes most of the time. */
#define CASE(name, statements)                                                                     \
    case RETRAX_##name: {                                                                          \
        for (;;) {                                                                                 \
            const double value = tape->values[k];                                                  \
            double *restrict const o = LANES_OF(0);                                                \
            (void)value;                                                                           \
            statements                                                                             \
            if (k + 1 >= instructions || tape->codes[k + 1] != RETRAX_##name) {                    \
                break;                                                                             \
            }                                                                                      \
            k++;                                                                                   \
        }                                                                                          \
        break;                                                                                     \
    }
#define RESULT(expression)                      \
    RETRAX_INDEPENDENT                          \
    for (retrax_index j = 0; j < padded; j++) { \
        o[j] = (expression);                    \
    }
#define NONE(name, expression) CASE(name, RESULT(expression))
#define UNARY(name, expression) CASE(name, const double *const x = LANES_OF(1); RESULT(expression))
#define BINARY(name, expression) \
    CASE(name, const double *const x = LANES_OF(1); const double *const y = LANES_OF(2); RESULT(expression))
#define TERNARY(name, expression)                                                                  \
    CASE(name, const double *const x = LANES_OF(1); const double *const y = LANES_OF(2);           \
         const double *const z = LANES_OF(3); RESULT(expression))
/* Up to seven arguments a[0], ..., a[6]. */
#define SUM(name, arguments, expression)              \
    CASE(name, const double *a[arguments];            \
         for (int i = 0; i < (arguments); i++) {      \
             a[i] = LANES_OF(i + 1);                  \
         } RESULT(expression))
/* Functions of libm, only at the points that there are. */
#define FUNCTION(name, expression)                                                                   \
    CASE(name, const double *const x = LANES_OF(1); const double *const y = LANES_OF(2); (void)y;    \
         for (retrax_index j = 0; j < count; j++) {                                                  \
             o[j] = (expression);                                                                    \
         })

/* Runs the tape at `points` points from `point` on, at most as many as there are lanes. */
TARGET static void MACHINE(const retrax_tape *tape, const retrax_tape_data *data, retrax_index point,
                           retrax_index points, double *registers, retrax_index columns) {
    const retrax_index count = ALONE ? 1 : points, lanes = ALONE ? 1 : columns;
    const retrax_index padded = ALONE ? 1 : (count + RETRAX_VECTOR - 1) & -(retrax_index)RETRAX_VECTOR;
    const retrax_index instructions = tape->instructions;
    retrax_index rounds = 0; /* of the loop, that are left */
    for (retrax_index k = 0; k < instructions; k++) {
        switch (tape->codes[k]) {
            BINARY(MUL, x[j] * y[j])
            TERNARY(MUL_ADD, FUSED(x[j], y[j], z[j]))
            TERNARY(MUL_SUB, FUSED(x[j], y[j], -z[j]))
            TERNARY(SUB_MUL, FUSED(-x[j], y[j], z[j]))
            TERNARY(ADD_ADD, x[j] + y[j] + z[j])
            SUM(MUL_ADD_ADD, 4, FUSED(a[0][j], a[1][j], a[2][j]) + a[3][j])
            SUM(TWO_MUL, 4, FUSED(a[2][j], a[3][j], a[0][j] * a[1][j]))
            SUM(TWO_MUL_ADD, 5, FUSED(a[3][j], a[4][j], FUSED(a[0][j], a[1][j], a[2][j])))
            SUM(MUL_SUB_MUL, 4, FUSED(a[2][j], a[3][j], -(a[0][j] * a[1][j])))
            SUM(THREE_MUL, 6, FUSED(a[4][j], a[5][j], FUSED(a[2][j], a[3][j], a[0][j] * a[1][j])))
            SUM(THREE_MUL_ADD, 7,
                FUSED(a[5][j], a[6][j], FUSED(a[3][j], a[4][j], FUSED(a[0][j], a[1][j], a[2][j]))))
            BINARY(ADD, x[j] + y[j])
            BINARY(SUB, x[j] - y[j])
            BINARY(DIV, x[j] / y[j])
            UNARY(MUL_CONST, x[j] * value)
            UNARY(ADD_CONST, x[j] + value)
            UNARY(CONST_SUB, value - x[j])
            UNARY(CONST_DIV, value / x[j])
            NONE(CONST, value)
            UNARY(STATE, x[j])
            UNARY(NEXT, x[j])
            UNARY(ASSIGN, x[j])
            UNARY(INV, 1.0 / x[j])
            UNARY(NEG, -x[j])
            UNARY(SQ, x[j] * x[j])
            UNARY(TWICE, x[j] + x[j])
            UNARY(SQRT, sqrt(x[j]))
            UNARY(FABS, fabs(x[j]))
            UNARY(NOT, x[j] != 0.0 ? 0.0 : 1.0)
            UNARY(SIGN, x[j] > 0.0 ? 1.0 : (x[j] < 0.0 ? -1.0 : x[j]))
            BINARY(LT, x[j] < y[j] ? 1.0 : 0.0)
            BINARY(LE, x[j] <= y[j] ? 1.0 : 0.0)
            BINARY(EQ, x[j] == y[j] ? 1.0 : 0.0)
            BINARY(NE, x[j] != y[j] ? 1.0 : 0.0)
            BINARY(AND, ((x[j] != 0.0) & (y[j] != 0.0)) ? 1.0 : 0.0)
            BINARY(OR, ((x[j] != 0.0) | (y[j] != 0.0)) ? 1.0 : 0.0)
            BINARY(FMIN, ((x[j] < y[j]) | (y[j] != y[j])) ? x[j] : y[j])
            BINARY(FMAX, ((x[j] > y[j]) | (y[j] != y[j])) ? x[j] : y[j])
            BINARY(IF_ELSE_ZERO, x[j] != 0.0 ? y[j] : 0.0)
            TERNARY(SELECT, x[j] != 0.0 ? y[j] : z[j])
            FUNCTION(COPYSIGN, copysign(x[j], y[j]))
            FUNCTION(POW, pow(x[j], y[j]))
            FUNCTION(CONSTPOW, pow(x[j], y[j]))
            FUNCTION(FMOD, fmod(x[j], y[j]))
            FUNCTION(ATAN2, atan2(x[j], y[j]))
            FUNCTION(HYPOT, hypot(x[j], y[j]))
            FUNCTION(FLOOR, floor(x[j]))
            FUNCTION(CEIL, ceil(x[j]))
            FUNCTION(SIN, sin(x[j]))
            FUNCTION(COS, cos(x[j]))
            FUNCTION(TAN, tan(x[j]))
            FUNCTION(EXP, exp(x[j]))
            FUNCTION(LOG, log(x[j]))
            FUNCTION(ASIN, asin(x[j]))
            FUNCTION(ACOS, acos(x[j]))
            FUNCTION(ATAN, atan(x[j]))
            FUNCTION(ERF, erf(x[j]))
            FUNCTION(SINH, sinh(x[j]))
            FUNCTION(COSH, cosh(x[j]))
            FUNCTION(TANH, tanh(x[j]))
            FUNCTION(ASINH, asinh(x[j]))
            FUNCTION(ACOSH, acosh(x[j]))
            FUNCTION(ATANH, atanh(x[j]))
            FUNCTION(LOG1P, log1p(x[j]))
            FUNCTION(EXPM1, expm1(x[j]))
            case RETRAX_INPUT:
                k += read_inputs(tape, data, k, point, count, registers, lanes) - 1;
                break;
            case RETRAX_OUTPUT:
                k += write_outputs(tape, data, k, point, count, registers, lanes) - 1;
                break;
            case RETRAX_LOOP:
                rounds = (retrax_index)tape->values[k];
                break;
            case RETRAX_REPEAT:
                rounds--;
                if (rounds > 0 && any_is_zero(LANES_OF(1), count)) {
                    k = (retrax_index)tape->values[k] - 1;
                }
                break;
            default:
                break; /* retrax_tape_check refuses other codes */
        }
    }
}

#undef LANES_OF
#undef CASE
#undef RESULT
#undef NONE
#undef UNARY
#undef BINARY
#undef TERNARY
#undef SUM
#undef FUNCTION
