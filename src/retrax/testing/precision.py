"""The precision that JAX is set to, and what rounding lets the checks say in it: all of it in powers of its machine
epsilon."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from ..manifolds.numerics.precision import working_precision

# What is known to less than this, relatively, says nothing: a fact is not decided there.
WORST = 1e-3


@dataclass(frozen=True)
class Precision:
    """Tolerances, steps and lengths that follow from ``eps``, the machine epsilon; ``name`` is single or double."""

    name: str
    eps: float

    @property
    def tolerance(self) -> float:
        """Rounding of values and first derivatives, after some hundred operations with what they magnify."""
        return 4500 * self.eps  # 1e-12 in double precision, 5e-4 in single

    @property
    def half(self) -> float:
        """Half of the digits: displacements at which an error of second order is lost in rounding."""
        return self.eps**0.5

    @property
    def tiny(self) -> float:
        """Three quarters of the digits: rounding is below, errors that lose half of the digits are above."""
        return self.eps**0.75

    @property
    def step(self) -> float:
        """Spacing of differences of functions of length scale 1: errors of order 4 are as large as rounding divided by
        it."""
        return self.eps**0.2

    @property
    def distances(self) -> np.ndarray:
        """Distances at which errors of first and second order differ, and rounding over the square is below 1."""
        return self.eps**0.4 * 2.0 ** np.arange(7)

    @property
    def displacement(self) -> float:
        """A short displacement off a manifold: rounding over it is small, and so is curvature times 128 of it."""
        return self.eps**0.45

    @property
    def quarter(self) -> float:
        """A quarter of the digits: what differences of displaced points are known to, at least."""
        return self.eps**0.25

    @property
    def floor(self) -> float:
        """Rounding of a few operations: errors above it have the logarithm that they would have without it, to a
        percent."""
        return 64 * self.eps


@lru_cache
def _precision(dtype: np.dtype) -> Precision:
    eps = float(np.finfo(dtype).eps)
    return Precision("double" if eps < 1e-12 else "single", eps)


def precision() -> Precision:
    """The precision in use."""
    return _precision(working_precision())
