"""Compiling kernels is not counted as running."""

import time

import numba
from retrax.integrators.boundary_value.engine.stopwatch import Stopwatch


def test_kernels_that_compile_are_counted_apart():
    kernels = [numba.njit(lambda x, k=k: x + k) for k in range(2)]
    kernels[0](1.0)  # outside: not heard
    with Stopwatch() as watch:
        time.sleep(0.02)
        quiet = watch.seconds()
        began = time.perf_counter()
        kernels[1](1.0)
        called = time.perf_counter() - began
        compiling, running = watch.seconds()
    kernels[1](1)  # compiles again, outside
    after = watch.seconds()[0]
    assert quiet[0] == 0.0
    assert quiet[1] >= 0.02
    assert 0.5 * called < compiling <= called
    assert quiet[1] <= running < quiet[1] + called
    assert after == compiling
