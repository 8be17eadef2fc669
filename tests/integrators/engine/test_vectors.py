# ruff: noqa: F405
"""Vectors of the processor and those of NumPy, which take their place without Numba, are the same to rounding."""

from types import FunctionType

import numpy as np
import pytest
from retrax.integrators.boundary_value.engine import llvm_vectors, numpy_vectors
from retrax.integrators.boundary_value.engine.arrays import LANES
from retrax.integrators.boundary_value.engine.llvm_vectors import *  # noqa: F403


def everything(x, rows, left, out, small):
    """Each function once: ``x`` and ``rows`` have three rows of three vectors, ``small`` rows that end within one."""
    a, b = vector(x, 0, 0), vector(x, 1, LANES)
    put(out, 0, 0, plus(a, scaled(2.0, b)))
    put(out, 0, LANES, minus(times(a, b), over(a, 3.0)))
    put(out, 0, 2 * LANES, add(subtract(a, 0.5, b), 1.5, filled(0.25)))
    put(out, 1, 0, larger(a, b))
    put(out, 1, LANES, higher(a, b))
    put(out, 1, 2 * LANES, root(magnitude(inverse(a))))
    put(out, 2, 0, within(a, LANES, LANES + 2, LANES + 5))
    put(out, 2, LANES, without(a, LANES, LANES + 3))
    put_entry(out, 2, 2 * LANES, highest(b))
    put_entry(out, 2, 2 * LANES + 1, total(b))
    put_entry(out, 2, 2 * LANES + 2, sought(b, entry(x, 1, LANES + 4)) + 10.0 * sought(b, 77.0))
    put_part(small, 0, LANES, plus(part(small, 1, LANES), filled(1.0)))
    add_vector(out, 2, LANES, 2.0, x, 1, 1)
    three_by_two(out, 3, 0, rows, 0, x, 0, 3)
    three_by_one(out, 6, LANES, rows, 1, x, 1, 2)
    one_by_one(out, 9, LANES, rows, 0, x, 0, 3)
    put(out, 10, 0, look_at_three(out, 11, 0, rows, 0, x, 0, 3, left))
    put(out, 10, LANES, look_at_two(out, 12, LANES, rows, 0, x, 1, 2, left))
    put(out, 10, 2 * LANES, look_at_one(out, 13, 2 * LANES, rows, 0, x, 0, 0, left))
    put(out, 14, 0, vector(view(x, LANES, (2, LANES)), 1, 0))


compiled_one = compiled(everything)


@pytest.mark.parametrize("special", [None, np.nan, 0.0, -np.inf])
def test_all_functions_are_the_same(special):
    draw = np.random.default_rng(0).standard_normal
    x, rows, left = draw((3, 3 * LANES)), draw((3, 3 * LANES)), (draw((2, 3 * LANES)) > 0) * 1.0
    if special is not None:
        x[0, 2], x[1, LANES + 2] = special, x[0, 3]
        x[1, LANES + 3] = special
    out, small = draw((15, 3 * LANES)), draw((2, 2 * LANES - 3))
    found = []
    plain = FunctionType(everything.__code__, {**vars(numpy_vectors), "LANES": LANES})
    for run in (compiled_one, numpy_vectors.compiled(plain)):
        arrays = [np.array(a) for a in (x, rows, left, out, small)]
        run(*arrays)
        found.append(arrays)
    for mine, other in zip(*found, strict=True):
        np.testing.assert_allclose(mine, other, rtol=1e-13, atol=1e-14)
    assert llvm_vectors.__all__ == numpy_vectors.__all__
