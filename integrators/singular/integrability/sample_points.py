"""Points of the jet space over ``T*Q`` with the derivative array linearised there, and at points a tiny step away."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any

import jax
import numpy as np
from jaxtyping import Array

from ....compute.jit_cache import compile_function
from ....manifolds import CotangentBundle
from ....manifolds.numerics import ambient as vec
from ....manifolds.numerics.ambient import Ambient
from ....retractions import BundleRetraction, default_retraction
from .derivative_array import DerivativeArray, Pair
from .echelon import COUNTED, JITTER, RANK_GAP, significance, without_small
from .linearisation import Linearisation, linearise
from .units import LEAST, Sizes, Units, own_sizes, sizes_at_starts, units_at

CONVERGED_VALUE = 1e-10  # largest value of an equation over its unit: how far its zeros are, in units
APPROACHED = 1e-6  # largest one, in units at the starts, of equations that are nearly met
LOOSE = 1e4  # of what is met as well as at the starts: how much worse by the sizes that all variables have at the point
RESOLUTION, TINY_STEPS = (
    1e-10,
    8,
)  # length of the tiny steps, in units, and their number: rounding rarely repeats so often
KERNEL_POINTS = 20  # points that the kernel takes

Numbers = np.ndarray | Array  # what the kernel returns is held as NumPy arrays


@lru_cache
def _kernel() -> Callable[..., Linearisation]:
    """Moves a batch of points by coordinates ``d`` of shape ``(batch, 2n + jet)`` and linearises the array there."""

    def batch(array: DerivativeArray, z: Pair, centers: Ambient, jets: Array, d: Array) -> Linearisation:
        bundle = CotangentBundle(array.problem.manifold)
        move = BundleRetraction(default_retraction(array.problem.manifold))

        def one(arguments: tuple[Pair, Ambient, Array, Array]) -> Linearisation:
            z, center, jet, d = arguments
            near = move(z, vec.combine(bundle.spanning_frame(z), d[: bundle.dimension]))
            return linearise(array, near, center, jet + d[bundle.dimension :].reshape(jet.shape))

        return jax.lax.map(one, (z, centers, jets, d))

    return compile_function(batch)


@dataclass(frozen=True)
class Points:
    """A batch of points of the jet space, with the array linearised there, and how the search for them ended.

    ``beside``: the same at points a tiny step away, leaves ``(TINY_STEPS, batch, ...)``; ``level``: the last of the
    equations that they were moved to, -1 for starts. ``slow``: the residual shrank slowly; ``away``: so it did while
    the steps stayed long, as where ``e^u`` is to vanish; ``unclear``: ranks there are not decided; ``opposed``: no
    direction makes all equations smaller; ``stiff``: the costate is moved less than the state.
    """

    array: DerivativeArray
    centers: Ambient
    at: Linearisation
    beside: Linearisation
    sizes: Sizes
    level: int
    slow: np.ndarray
    away: np.ndarray
    unclear: np.ndarray
    opposed: np.ndarray
    stiff: np.ndarray

    @cached_property
    def units(self) -> Units:
        """The units of each point by itself."""
        return units_at(self.at, self.sizes)

    @cached_property
    def residuals(self) -> np.ndarray:
        """The largest value of an equation up to the level, over what that equation is made of at the point."""
        return np.max(relative(self.at, self.units.rows, max(self.level, 0)), axis=1)

    @cached_property
    def consistent(self) -> np.ndarray:
        """Whether each point satisfies every equation up to the level, in units and relative to the effect of tiny
        steps.

        These steps do not leave the domain of the functions.
        """
        level = max(self.level, 0)
        zero = np.max(significance(self.stack("array")[:, :, : level + 1]), axis=(1, 2)) <= RANK_GAP
        inside = np.isfinite([relative(vec.taken(self.beside, i), self.sizes.rows, level) for i in range(TINY_STEPS)])
        rows = np.maximum(self.sizes.rows, LOOSE * own_sizes(self.at))
        zero &= (np.max(relative(self.at, rows, level), axis=1) <= CONVERGED_VALUE) & inside.all(axis=(0, 2))
        return (self.residuals <= CONVERGED_VALUE) & zero & ~self.away & (self.level >= 0)

    @cached_property
    def approach(self) -> np.ndarray:
        """The largest value of an equation up to the level, over what that equation is made of at the starts."""
        return np.max(relative(self.at, self.sizes.rows, max(self.level, 0)), axis=1)

    @property
    def regular(self) -> np.ndarray:
        """Consistent points whose ranks can be read."""
        return self.consistent & ~self.slow & ~self.unclear

    @cached_property
    def slopes(self) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives along the state and the jet as stacks, without what is rounding of their terms.

        Rounding that is the same beside a point, as that of constants, is told by its size alone.
        """
        return self._slopes(JITTER)

    def _slopes(self, change: float) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives along the state and the jet, without entries that are small and change by at most ``change``."""
        least = LEAST * self.units.terms[..., None]
        by_state, by_jet = self.stack("by_state"), self.stack("by_jet")
        return (
            without_small(by_state, least / self.units.state[:, None, None], change),
            without_small(by_jet, least[..., None] / self.units.jet[:, None, None], change),
        )

    def exceeds_rounding(self) -> np.ndarray:
        """Whether each derivative along the state exceeds rounding, ``(batch, order + 1, m, 2n)``."""
        return significance(self.slopes[0]) > COUNTED

    @property
    def rounded(self) -> "Points":
        """The points without any derivatives that are smaller than the rounding of the terms of their equations.

        So is what ``exp(-50)`` adds beside 1: a rank that depends on it is that of another problem.
        """
        by_state, by_jet = self._slopes(np.inf)
        at = self.at._replace(by_state=by_state[:, 0], by_jet=by_jet[:, 0])
        beside = self.beside._replace(
            by_state=np.moveaxis(by_state[:, 1:], 1, 0), by_jet=np.moveaxis(by_jet[:, 1:], 1, 0)
        )
        return replace(self, at=at, beside=beside)

    def stack(self, name: str) -> np.ndarray:
        """A part of the linearised array at the points and beside them, ``(batch, 1 + TINY_STEPS, ...)``."""
        return np.concatenate([getattr(self.at, name)[:, None], np.moveaxis(getattr(self.beside, name), 0, 1)], axis=1)

    def stacks(self, level: int) -> tuple[np.ndarray, np.ndarray]:
        """``F_z`` and ``F_U`` of the levels up to this one, at the points and beside them, in units.

        Shapes ``(batch, 1 + TINY_STEPS, rows, 2n)`` and ``(batch, 1 + TINY_STEPS, rows, rows)``.
        """
        return in_units(*self.slopes, self.units, level)

    def matrices(self, level: int) -> tuple[np.ndarray, np.ndarray]:
        """``F_z`` and ``F_U`` at the points alone, in units, ``(batch, rows, 2n)`` and ``(batch, rows, rows)``."""
        by_state, by_jet = in_units(self.at.by_state[:, None], self.at.by_jet[:, None], self.units, level)
        return by_state[:, 0], by_jet[:, 0]


def in_units(by_state: Numbers, by_jet: Numbers, units: Units, level: int) -> tuple[np.ndarray, np.ndarray]:
    """Derivatives of the levels up to this one, ``(batch, samples, ...)``, with rows and columns scaled and raveled."""
    k = level + 1
    batch, samples, _, m = by_state.shape[:4]
    scale = units.rows[:, None, :k].reshape(batch, 1, k * m, 1)
    along = units.jet[:, None, None, :k].reshape(batch, 1, 1, k * m)
    with np.errstate(all="ignore"):  # functions that overflow are told by values that are not finite
        states = (
            np.asarray(by_state)[:, :, :k].reshape(batch, samples, k * m, by_state.shape[-1])
            / scale
            * units.state[:, None, None]
        )
        jets = np.asarray(by_jet)[:, :, :k, :, :k].reshape(batch, samples, k * m, k * m) / scale * along
    return states, jets


def relative(at: Linearisation, rows: np.ndarray, level: int) -> np.ndarray:
    """Equations up to a level in units, ``(batch, equations)``; infinite where they or the functions are not finite."""
    k, batch = level + 1, len(at.array)
    parts = at.array[:, :k], at.by_state[:, :k], at.by_jet[:, :k, :, :k], at.cost_rate, at.velocity
    finite = np.all([np.isfinite(part.reshape(batch, -1)).all(axis=1) for part in parts], axis=0)
    with np.errstate(all="ignore"):
        return np.where(finite[:, None], np.abs(at.array / rows)[:, :k].reshape(batch, -1), np.inf)


def evaluate(array: DerivativeArray, z: Pair, centers: Ambient, jets: np.ndarray, lengths: np.ndarray) -> Points:
    """The starts with the sizes of the array there, for sizes ``lengths`` of the coordinates of Q."""
    count = len(jets)
    at = move(array, z, centers, jets)
    unknown = np.zeros(jets.shape[1:], bool)
    sizes = sizes_at_starts(at, lengths, unknown)
    no, stiff = np.zeros(count, bool), np.arange(count) % 2 == 1
    points = Points(
        array, centers, at, tiny_steps(array, centers, at, units_at(at, sizes)), sizes, -1, no, no, no, no, stiff
    )
    slopes, known = (
        significance(points.slopes[1].reshape(count, 1 + TINY_STEPS, *unknown.shape, -1)),
        points.exceeds_rounding(),
    )
    rounding = ~((slopes > COUNTED).any(axis=-1) | known.any(axis=-1))
    return replace(points, sizes=sizes_at_starts(at, lengths, 2 * rounding.sum(axis=0) > count))


def move(
    array: DerivativeArray, z: Pair, centers: Ambient, jets: Numbers, d: np.ndarray | None = None
) -> Linearisation:
    """The array linearised at points, moved by coordinates ``d`` if these are given.

    Batches are filled up with their first point to a multiple of ``KERNEL_POINTS``: there is one kernel for those that
    shrink.
    """
    size = CotangentBundle(array.problem.manifold).dimension + jets[0].size
    d = np.zeros((len(jets), size)) if d is None else d
    filled = np.pad(np.arange(len(jets)), (0, -len(jets) % KERNEL_POINTS))
    arguments = vec.taken((z, centers, jets, d), filled)
    return vec.taken(_kernel()(array, *arguments), slice(len(jets)))


def tiny_steps(array: DerivativeArray, centers: Ambient, at: Linearisation, units: Units) -> Linearisation:
    """The array linearised a tiny random step away, several times, in the frames of the points."""
    steps = RESOLUTION * np.random.default_rng(0).standard_normal((TINY_STEPS, *units.both.shape)) * units.both
    found = [_turn(move(array, at.z, centers, at.jet, d), at) for d in steps]
    return vec.stacked(found)


def _turn(beside: Linearisation, at: Linearisation) -> Linearisation:
    """Values beside points in frames that are nearly the frames of the points.

    Frames may jump between them: no sphere of even dimension has a continuous one.
    """
    n = at.position.shape[-1]
    own, wanted = (np.asarray(jax.vmap(vec.flatten_frame)(one.frame[0]))[:, :n] for one in (beside, at))
    turn = np.zeros((len(own), 2 * n, 2 * n))
    turn[:, :n, :n] = turn[:, n:, n:] = own @ np.swapaxes(wanted, 1, 2)
    by_state, omega = beside.by_state @ turn[:, None], np.swapaxes(turn, 1, 2) @ beside.omega @ turn
    return beside._replace(by_state=by_state, omega=omega)


def with_order(points: Points, order: int) -> Points:
    """The points with a derivative array of this order, and with sizes as if they were starts."""
    more = order - points.array.order
    jets = np.concatenate([points.at.jet, np.zeros((len(points.slow), more, points.at.jet.shape[-1]))], axis=1)
    return evaluate(
        DerivativeArray(points.array.problem, order), points.at.z, points.centers, jets, points.sizes.lengths
    )


def select(points: Points, which: Any) -> Points:
    """A part of a batch."""
    centers, at = vec.taken((points.centers, points.at), which)
    beside = vec.taken(points.beside, np.s_[:, which])
    evidence = [part[which] for part in (points.slow, points.away, points.unclear, points.opposed, points.stiff)]
    return Points(points.array, centers, at, beside, points.sizes, points.level, *evidence)
