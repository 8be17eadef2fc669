/*
 * The instructions of tapes: the one list of their names and numbers of arguments, in the order of their codes.
 *
 * src/retrax/tape/instructions.py has the same list; a test compares the two.
 */
#ifndef RETRAX_TAPE_H
#define RETRAX_TAPE_H

#include "retrax_core.h"

#define RETRAX_INSTRUCTIONS(X)                                                                                \
    X(ADD, 2) X(SUB, 2) X(MUL, 2) X(DIV, 2) X(MUL_ADD, 3) X(MUL_SUB, 3) X(SUB_MUL, 3) X(ADD_ADD, 3)           \
    X(MUL_ADD_ADD, 4) X(TWO_MUL, 4) X(TWO_MUL_ADD, 5) X(MUL_SUB_MUL, 4) X(THREE_MUL, 6) X(THREE_MUL_ADD, 7)   \
    X(ADD_CONST, 1) X(MUL_CONST, 1) X(CONST_SUB, 1) X(CONST_DIV, 1) X(SELECT, 3) X(CONST, 0) X(INPUT, 0)      \
    X(OUTPUT, 1) X(STATE, 1) X(LOOP, 0) X(NEXT, 1) X(REPEAT, 1) X(IF_ELSE_ZERO, 2) X(POW, 2) X(CONSTPOW, 2)   \
    X(LT, 2) X(LE, 2) X(EQ, 2) X(NE, 2) X(AND, 2) X(OR, 2) X(FMOD, 2) X(COPYSIGN, 2) X(FMIN, 2) X(FMAX, 2)    \
    X(ATAN2, 2) X(HYPOT, 2) X(NEG, 1) X(SQ, 1) X(TWICE, 1) X(SQRT, 1) X(INV, 1) X(ASSIGN, 1) X(NOT, 1)        \
    X(FLOOR, 1) X(CEIL, 1) X(FABS, 1) X(SIGN, 1) X(SIN, 1) X(COS, 1) X(TAN, 1) X(EXP, 1) X(LOG, 1) X(ASIN, 1) \
    X(ACOS, 1) X(ATAN, 1) X(ERF, 1) X(SINH, 1) X(COSH, 1) X(TANH, 1) X(ASINH, 1) X(ACOSH, 1) X(ATANH, 1)      \
    X(LOG1P, 1) X(EXPM1, 1)

#define RETRAX_CODE_OF(name, arguments) RETRAX_##name,
enum { RETRAX_INSTRUCTIONS(RETRAX_CODE_OF) RETRAX_CODES };
#undef RETRAX_CODE_OF

/* Consecutive inputs or outputs that the machine moves at once. */
#define RETRAX_GROUP 4

#endif /* RETRAX_TAPE_H */
