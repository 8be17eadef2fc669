"""The barrier of the inequalities of a batch: its units, its first slacks, when it is lowered and when excesses cost
more."""

from typing import NamedTuple, final

import numpy as np
from numpy.typing import ArrayLike

from ....manifolds.numerics.tolerances import EPS
from ..transcription.iterate import Slacks
from .arrays import plain
from .inequalities import VALUE, Held, Surveyed, central, surveyed

INSIDE = 1e-2  # of its unit: an inequality that holds by less to begin with is elastic
FIRST = 0.3  # the first barrier, relative to the unit of the cost rate
# A barrier problem is solved to 10 mu; then mu is the smaller of mu / 5 and mu^1.5.
SOLVED, LESS, FASTER = 10.0, 0.2, 1.5
REACHED = 4 * EPS  # of the last barrier: one that is above it by no more is the last
LAST = 0.1  # of the tolerance: the last barrier, relative
# Known multipliers are followed for a step from each of these barriers, the first the last one of a usual tolerance. Of
# what slacks or multipliers lack then a share, squared, is the barrier to begin with; a higher one does not fit.
LEVELS, FOLLOWED, FITS = (LAST * EPS**0.7, 1e-7, 1e-5, 1e-3, 1e-2), 0.1, 0.1
PRICE, DEARER, DEAREST = 10.0, 3.0, 1e6  # of an excess, relative to the units of the cost rate and of the inequality
TELLS = 0.1  # of its unit: above this barrier excesses are left whatever they cost
NEAR = 0.5  # of its price, a multiplier says that it is too low
PRICES = PRICE, NEAR, DEAREST
LOWERING = SOLVED, LESS, FASTER, REACHED, TELLS


@final
class Barrier(NamedTuple):
    """Units of the cost per time, shape (B,), and of the inequalities, (B, c); which of these no iterate leaves.

    ``firm``: by how much the first prices, and the square of the first barrier, exceed the usual ones, shape (B,). The
    price of an excess of the bounds of what is free, which no iterate leaves, is infinite.
    """

    rate: np.ndarray
    limits: np.ndarray
    kept: np.ndarray
    firm: np.ndarray

    @classmethod
    def of(cls, held: Held, sizes: np.ndarray, rate: np.ndarray, kept: np.ndarray, firm: ArrayLike = 1.0) -> "Barrier":
        """The units where the unknowns of the points have these sizes: what these change an inequality by to first
        order, or its value where that is next to nothing, as that of a ball where its derivative vanishes."""
        size = (np.abs(held.jacobian) * sizes[:, :, :, None]).sum(axis=4).max(axis=(1, 2))
        value = np.abs(held.values).max(axis=(1, 2))
        size = np.where(size > VALUE * value, size, value)  # what is next to nothing tells nothing of how it bends
        limits = np.where((size > 0) & np.isfinite(size), size, 1.0)
        return cls(rate, limits, np.broadcast_to(kept, size.shape), np.full_like(rate, firm))

    @property
    def unit(self) -> np.ndarray:
        """The units of the inequalities with the axes of the points."""
        return self.limits[:, None, None]

    @property
    def multiplier(self) -> np.ndarray:
        """The unit of the multipliers."""
        return self.rate[:, None, None, None] / self.unit

    @property
    def price(self) -> np.ndarray:
        """The unit of the prices."""
        return np.where(self.kept[:, None, None], np.inf, self.multiplier * self.firm[:, None, None, None])

    @property
    def highest(self) -> np.ndarray:
        """The first barrier."""
        return FIRST * self.rate * np.sqrt(self.firm)

    def _inside(self, held: Held) -> Held:
        """The inequalities, of which those that no iterate leaves hold by rounding at least."""
        return held._replace(
            values=np.where(self.kept[:, None, None], np.minimum(held.values, -EPS * self.unit), held.values)
        )

    def first(self, held: Held) -> Slacks:
        """The slacks to begin with: those of inequalities that do not hold by enough are elastic."""
        held = self._inside(held)
        price = np.where(held.values < -INSIDE * self.unit, np.inf, PRICE * self.price)
        return central(held, self.highest, price)

    def lacks(self, held: Held, slacks: np.ndarray, multipliers: np.ndarray) -> np.ndarray:
        """By how much a slack or a multiplier is below zero, in its unit, shape (B,)."""
        least = np.minimum(slacks / self.unit, multipliers / self.multiplier)
        return np.where(held.asked, -least, 0.0).max(axis=(1, 2, 3), initial=0.0)

    def near(self, held: Held, slacks: np.ndarray, multipliers: np.ndarray, barrier: np.ndarray) -> Slacks:
        """The slacks and multipliers with ``nu s = mu`` that are nearest to given ones, which may be negative: ``s - k
        nu`` stays as it is, where ``k`` makes them of one unit.

        ``barrier``: relative to the unit of the cost rate. Nothing is elastic: an inequality that pulls and does not
        hold is left so. The slack of a bound that no iterate leaves is ``-g``, and its multiplier the known one.
        """
        held, kept = self._inside(held), self.kept[:, None, None]
        mu, k = (barrier * self.rate)[:, None, None, None], self.unit / self.price
        apart = np.where(kept, -held.values, slacks - k * multipliers)
        more = (np.sqrt(apart * apart + 4 * k * mu) + np.abs(apart)) / 2
        slacks = np.where(held.asked, np.where(apart > 0, more, k * mu / more), 1.0)
        own = np.where(held.asked, np.maximum(mu / slacks, np.where(kept, multipliers, 0.0)), 0.0)
        return Slacks(slacks, own, np.zeros_like(own), np.full_like(own, np.inf), barrier * self.rate)

    def is_hard(self, held: Held, slacks: Slacks) -> np.ndarray:
        """Whether there are inequalities that are not elastic and can be, shape (B,)."""
        return np.any(held.asked & ~slacks.elastic & ~self.kept[:, None, None], axis=(1, 2, 3))

    def softened(self, held: Held, slacks: Slacks, where: np.ndarray) -> Slacks:
        """The slacks with all inequalities elastic in some members."""
        price = np.where(where[:, None, None, None], np.minimum(slacks.price, PRICE * self.price), slacks.price)
        fresh = central(
            self._inside(held), np.where(where, np.maximum(slacks.barrier, self.highest), slacks.barrier), price
        )
        return Slacks(
            *(np.where(where.reshape(-1, *(1,) * (a.ndim - 1)), a, b) for a, b in zip(fresh, slacks, strict=True))
        )

    def surveyed(self, held: Held, slacks: Slacks) -> np.ndarray:
        """What the inequalities and their multipliers lack, and what they cost: the fields of ``Surveyed``."""
        return surveyed(held, slacks, self.limits, self.rate, PRICES)

    def lowered(
        self, found: Surveyed, slacks: Slacks, error: np.ndarray, tolerance: float, dear: np.ndarray
    ) -> tuple[Slacks, np.ndarray]:
        """The slacks with a lower barrier where its problem is solved, and where excesses are too cheap instead.

        ``error``: the largest residual but for that of ``nu s = mu``; ``dear``: what all multipliers have grown by.
        """
        from . import inequality_kernels

        rate, out = self.rate * dear, (np.empty(len(error)), np.empty(len(error), bool))
        told = tuple(map(plain, (found.product, found.least, found.cheap)))
        own = plain(slacks.barrier), rate, LAST * tolerance * self.rate / rate
        inequality_kernels.lower(*own, told, plain(error), tolerance, LOWERING, out)
        return slacks._replace(barrier=out[0]), out[1]

    def is_infeasible(self, found: Surveyed, slacks: Slacks, error: np.ndarray, tolerance: float) -> np.ndarray:
        """Whether excesses are left at the highest price, where all else is solved but for a small barrier.

        ``error``: the largest residual but for those of the multipliers. Small ones are seen at the last barrier, where
        nothing is left to lower.
        """
        small, last = (slacks.barrier <= share * self.rate for share in (np.sqrt(tolerance), 2 * LAST * tolerance))
        last &= (found.product <= SOLVED * slacks.barrier) & (found.left > 0) & (found.excess > tolerance)
        return (error <= tolerance) & (small & (found.left > np.sqrt(tolerance)) | last)

    @staticmethod
    def dear(found: Surveyed) -> np.ndarray:
        """What all multipliers, and the unit of the barrier, have grown by with the price of excesses, shape (B,)."""
        return np.maximum(found.dear, 1.0)
