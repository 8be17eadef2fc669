"""The precision that JAX is set to: its dtypes, and how near numbers in it have to be to count as equal."""

from functools import cache

import jax
import numpy as np
from jaxtyping import Array, Bool

from . import ambient as vec
from .ambient import Ambient
from .tolerances import HALF


def working_precision() -> np.dtype:
    """The dtype of real numbers in the precision that JAX is set to."""
    return jax.dtypes.canonicalize_dtype(float)


def default_tolerance() -> float:
    """Square root of the machine epsilon of the precision in use."""
    return _root_of_epsilon(working_precision())


@cache
def _root_of_epsilon(precision: np.dtype) -> float:
    return float(np.finfo(precision).eps ** HALF)


def real(shape: tuple[int, ...]) -> jax.ShapeDtypeStruct:
    """Real array of a shape, in the precision that JAX is set to."""
    return jax.ShapeDtypeStruct(shape, working_precision())


def complex_entries(shape: tuple[int, ...]) -> jax.ShapeDtypeStruct:
    """Complex array of a shape, in the precision that JAX is set to."""
    return jax.ShapeDtypeStruct(shape, jax.dtypes.canonicalize_dtype(complex))


def same_point(x: Ambient, y: Ambient, tolerance: float) -> Bool[Array, ""]:
    """Whether two points agree entry by entry, relative to ``1 + max |y|``."""
    return vec.size(vec.subtract(x, y)) <= tolerance * (1 + vec.size(y))
