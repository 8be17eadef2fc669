/* Kernels of dense algebra, once for each instruction set. */
#include "kernels.h"

#include "instruction_sets.h"

#include <string.h>

#define FUSED RETRAX_PORTABLE_FUSED
#define KERNEL(name) portable_##name
#define TARGET
#include "kernel_set.h"
#undef FUSED
#undef KERNEL
#undef TARGET

#if RETRAX_HAS_X86_SETS
#define FUSED __builtin_fma
#define KERNEL(name) avx2_##name
#define TARGET RETRAX_TARGET_AVX2
#include "kernel_set.h"
#undef KERNEL
#undef TARGET

#define KERNEL(name) avx512_##name
#define TARGET RETRAX_TARGET_AVX512
#include "kernel_set.h"
#undef KERNEL
#undef TARGET
#undef FUSED
#endif

const retrax_kernels *retrax_kernels_for(retrax_instruction_set set) {
    switch (set) {
#if RETRAX_HAS_X86_SETS
        case RETRAX_AVX2:
            return &avx2_kernels;
        case RETRAX_AVX512:
            return &avx512_kernels;
#endif
        default:
            return &portable_kernels;
    }
}
