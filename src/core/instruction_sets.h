/*
 * Instruction sets: functions that the core compiles for each of them, and hints for loops over vectors.
 *
 * A file that has such functions is a header without a guard. The file that owns it includes it once for each set,
 * with TARGET, the attribute of its functions, and FUSED(x, y, z), which is x y + z, rounded once if the set can do that.
 */
#ifndef RETRAX_INSTRUCTION_SETS_H
#define RETRAX_INSTRUCTION_SETS_H

#include "retrax_core.h"

#include <math.h>

/* gcc and clang compile single functions for other instruction sets. */
#if defined(__x86_64__) && defined(__GNUC__) && !defined(RETRAX_ONE_INSTRUCTION_SET)
#define RETRAX_HAS_X86_SETS 1
#else
#define RETRAX_HAS_X86_SETS 0
#endif

#define RETRAX_TARGET_AVX2 __attribute__((target("avx2,fma")))
#define RETRAX_TARGET_AVX512 __attribute__((target("avx512f,avx512dq,avx512vl,avx2,fma")))

/* x y + z for the instruction set that the compiler is asked for. */
#ifdef FP_FAST_FMA
#define RETRAX_PORTABLE_FUSED(x, y, z) fma(x, y, z)
#else
#define RETRAX_PORTABLE_FUSED(x, y, z) ((x) * (y) + (z))
#endif

/* Before a loop whose rounds do not depend on each other: what it writes, it does not read. */
#if defined(__clang__)
#define RETRAX_INDEPENDENT _Pragma("clang loop vectorize(assume_safety) interleave(disable)")
#elif defined(__GNUC__)
#define RETRAX_INDEPENDENT _Pragma("GCC ivdep")
#else
#define RETRAX_INDEPENDENT
#endif

#endif /* RETRAX_INSTRUCTION_SETS_H */
