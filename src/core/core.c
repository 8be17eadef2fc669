/* Version, status messages, and the instruction set of the processor. */
#include "instruction_sets.h"

#include <stdbool.h>

#if RETRAX_HAS_X86_SETS
#include <cpuid.h>
#endif

int retrax_core_version(void) { return RETRAX_CORE_VERSION; }

const char *retrax_status_message(int status) {
    switch (status) {
        case RETRAX_OK:
            return "no error";
        case RETRAX_BAD_SIZE:
            return "a count is negative or an array is missing";
        case RETRAX_BAD_INSTRUCTION:
            return "a code is not in the list of instructions";
        case RETRAX_BAD_REGISTER:
            return "an operand is not a register, or a result overwrites an operand";
        case RETRAX_BAD_PLACE:
            return "an input or output lies outside of its array";
        case RETRAX_BAD_LOOP:
            return "a loop has no beginning, no end, or no whole number of rounds";
        case RETRAX_BAD_LANES:
            return "the number of lanes is neither 1 nor a positive multiple of 8";
        default:
            return "unknown status";
    }
}

#if RETRAX_HAS_X86_SETS
/* Whether the operating system keeps all registers in `mask` of extended control register 0 (XCR0). */
static bool keeps_registers(unsigned int mask) {
    unsigned int low, high;
    __asm__ volatile("xgetbv" : "=a"(low), "=d"(high) : "c"(0));
    return (low & mask) == mask;
}
#endif

/* Not by __builtin_cpu_supports, which some compilers resolve to "nothing" [zig 0.17]. */
retrax_instruction_set retrax_best_instruction_set(void) {
#if RETRAX_HAS_X86_SETS
    const unsigned int ymm = 0x6, zmm = 0xe6; /* bits of XCR0 */
    const unsigned int osxsave = 1u << 27, fma = 1u << 12, avx2 = 1u << 5;
    const unsigned int avx512 = 1u << 16 | 1u << 17 | 1u << 31; /* F, DQ, VL */
    unsigned int a, b, c, d;
    if (__get_cpuid(1, &a, &b, &c, &d) && (c & osxsave) && (c & fma) && keeps_registers(ymm) &&
        __get_cpuid_count(7, 0, &a, &b, &c, &d) && (b & avx2)) {
        return (b & avx512) == avx512 && keeps_registers(zmm) ? RETRAX_AVX512 : RETRAX_AVX2;
    }
#endif
    return RETRAX_PORTABLE;
}
