"""Vectors of numbers in kernels: of the processor, or of NumPy where there is no Numba to compile the kernels."""

from ....optional import numba_is_there

if numba_is_there():
    from .llvm_vectors import *  # noqa: F403
else:
    from .numpy_vectors import *  # noqa: F403
