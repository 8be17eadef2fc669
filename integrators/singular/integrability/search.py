"""The search for consistent points: batched, damped Levenberg-Marquardt steps of least norm."""

from dataclasses import replace
from typing import NamedTuple

import jax
import numpy as np

from ....manifolds.numerics.levenberg import SHORTENING
from .sample_points import CONVERGED_VALUE, Linearisation, Points, in_units, move, relative, tiny_steps
from .units import Units, units_at

MOST_SEARCH_STEPS = 100  # most steps of a search
FURTHER = 1e-3  # of what counts as converged: the search ends at as little
ARMIJO = 1e-4  # of a step: what the equations shrink by at least, relative
PSEUDO_INVERSE_CUTOFF = 1e-9  # of the largest singular value: smaller singular values are zero
LARGEST_SHIFT = 1e-2  # of the squares of the equations, in units: a larger shift would make steps far from P_f short
DESCENTS = 30  # steps of descent
# How much rather these move the control than the state, and steps of stiff points the state than the costate.
EASE = 10.0
# Tiny residuals that shrink slower, this often: an irregular constraint.
SLOW_RATIO, SLOW_STEPS, SLOW_BELOW = 0.1, 4, 1e-8
LONG_STEP = 1e-2  # steps, in units, of points that go to infinity while residuals are that tiny
CONTRADICTED_SHARE = 0.3  # of the equations that a step of size one takes away, where they contradict each other
DISTANCE_BESIDE = 1e-3  # how far, in units, points are taken beside others to see whether their ranks are the same


def make_consistent(points: Points, level: int, unit_costate: bool) -> Points:
    """Points moved to ``F_0 = ... = F_level = 0``, and to ``|p| = 1`` in units if asked, by damped steps of least norm.

    Those that come to none, or to irregular ones, as where pieces cross, are tried again: without making much of
    equations that are small there, as ``x^2 y`` is beside ``x y^2`` on ``x = 0``, then with ``DESCENTS`` steps of
    descent before as well.
    """
    best = _move(points, _Search(points, level, unit_costate, False), np.ones(len(points.slow), bool), 0)
    for descents in (0, DESCENTS):
        stuck = (best.slow & best.consistent & ~points.slow) | ~best.consistent
        if stuck.any():
            again = _move(points, _Search(points, level, unit_costate, True), stuck, descents)
            best = _better(stuck & again.consistent & ~again.slow, again, best)
    return best


def _better(which: np.ndarray, again: Points, points: Points) -> Points:
    """The points, replaced by the points of another try that came to regular equations."""
    at = jax.tree.map(lambda a, b: _where(which, a, b), again.at, points.at)
    beside = jax.tree.map(
        lambda a, b: np.stack([_where(which, *pair) for pair in zip(a, b, strict=True)]), again.beside, points.beside
    )
    return replace(points, at=at, beside=beside, slow=points.slow & ~which, away=points.away & ~which)


def _move(points: Points, search: "_Search", which: np.ndarray, descents: int) -> Points:
    """Steps are taken if the equations shrink in the units of the point before."""
    at, going, slow = points.at, which, np.zeros(len(which), int)
    damping = np.full(len(which), SHORTENING.first)
    residual = search.residual(at, at)
    for i in range(MOST_SEARCH_STEPS):
        active = going & (residual > FURTHER * CONVERGED_VALUE) & (damping <= SHORTENING.largest)
        if not active.any():
            break
        length = 1 / np.maximum(damping, 1.0)
        d = np.where(active, length, 0.0)[:, None] * search.directions(at, i < descents)
        tried = move(points.array, at.z, points.centers, at.jet, d)
        now, own = search.residual(tried, at), search.residual(tried, tried)
        better = active & (now < (1 - ARMIJO * length) * residual)
        at = jax.tree.map(lambda a, b, better=better: _where(better, a, b), tried, at)
        slow += better & (damping == 0) & (now > SLOW_RATIO * residual) & (now < SLOW_BELOW)
        residual = np.where(better, own, residual)
        going = going & (better | (residual > CONVERGED_VALUE))
        damping = SHORTENING.after(damping, better)
    return search.end_points(at, slow >= SLOW_STEPS)


def _where(which: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The points of ``a`` where ``which`` is true, and of ``b`` elsewhere."""
    return np.where(which.reshape(-1, *[1] * (a.ndim - 1)), a, b)


def points_beside(points: Points, level: int, unit_costate: bool) -> Points:
    """Consistent points at a random short distance from a batch, where pieces that cross lie apart."""
    count, reach = len(points.slow), points.at.velocity.shape[1] + (level + 1) * points.at.jet.shape[-1]
    d = DISTANCE_BESIDE * points.units.both * np.random.default_rng(0).standard_normal(points.units.both.shape)
    d[:, reach:] = 0.0  # derivatives of the control that do not enter
    at = move(points.array, points.at.z, points.centers, points.at.jet, d)
    return make_consistent(replace(points, at=at, slow=np.zeros(count, bool)), level, unit_costate)


class _Search(NamedTuple):
    """The selection of equations that are solved, with units that are not smaller than at the starts."""

    points: Points
    level: int
    unit_costate: bool
    coarse: bool

    def units(self, at: Linearisation) -> Units:
        """In which equations and steps are measured at points."""
        units = units_at(at, self.points.sizes)
        return replace(units, rows=np.maximum(units.rows, self.points.sizes.rows)) if self.coarse else units

    def end_points(self, at: Linearisation, slow: np.ndarray) -> Points:
        """The points where the search ended."""
        points, units = self.points, units_at(at, self.points.sizes)
        steps = np.linalg.norm(self.directions(at, False) / units.both, axis=1)
        points = replace(points, at=at, beside=tiny_steps(points.array, points.centers, at, units), level=self.level)
        return replace(
            points,
            slow=points.slow | slow,
            away=points.away | (slow & (steps > LONG_STEP)),
            unclear=np.zeros_like(slow),
            opposed=self.slopes(at) <= CONTRADICTED_SHARE,
        )

    def residual(self, at: Linearisation, before: Linearisation) -> np.ndarray:
        """Norm of the equations in the units of a point; infinite where one, or a function of the problem, is not
        finite."""
        values = relative(at, self.units(before).rows, self.level)
        with np.errstate(over="ignore"):
            return np.linalg.norm(np.concatenate([values, np.abs(self.normalisation(at)[0])], axis=1), axis=1)

    def slopes(self, at: Linearisation) -> np.ndarray:
        """How much of the equations, in the sizes that they have at the starts, a step of size one can take away."""
        rows = np.broadcast_to(self.points.sizes.rows, at.array.shape)
        units = replace(units_at(at, self.points.sizes), rows=rows)
        by_state, by_jet = (
            part[:, 0] for part in in_units(at.by_state[:, None], at.by_jet[:, None], units, self.level)
        )
        with np.errstate(all="ignore"):  # not finite where functions are not
            values = (at.array / rows)[:, : self.level + 1].reshape(len(rows), -1)
            size, tilt = self.normalisation(at)
            sizes = np.sum(values**2, axis=1, keepdims=True) + np.sum(size**2, axis=1, keepdims=True)
            slopes = np.einsum("br,bri->bi", values / sizes, np.concatenate([by_state, by_jet], axis=2))
            slopes[:, : tilt.shape[2]] += np.einsum("br,bri->bi", size / sizes, tilt * units.state[:, None])
            return np.where(np.isfinite(sizes[:, 0]), np.linalg.norm(slopes, axis=1), np.inf)

    def normalisation(self, at: Linearisation) -> tuple[np.ndarray, np.ndarray]:
        """``(|p|^2 - 1) / 2`` in typical sizes, and its derivatives by the coordinates of ``T*Q``; no rows if it is not
        asked."""
        sizes, n = self.points.sizes.state, at.costate.shape[1]
        slope = np.concatenate([np.zeros_like(at.costate), at.costate / sizes[n:]], axis=1)
        value = (np.sum(slope**2, axis=1, keepdims=True) - 1) / 2
        return value[:, : int(self.unit_costate)], (slope / sizes)[:, None][:, : int(self.unit_costate)]

    def directions(self, at: Linearisation, descent: bool) -> np.ndarray:
        """Steps of Levenberg and Marquardt, zero for derivatives of the control that do not enter; ``(batch, 2n +
        jet)``.

        With ``descent`` nearly along the gradient in units in which control and derivatives are moved rather than the
        state: these go to one of the pieces that cross, while steps of Gauss and Newton go straight to where they do.
        """
        units, k = self.units(at), self.level + 1
        by_state, by_jet = (
            part[:, 0] for part in in_units(at.by_state[:, None], at.by_jet[:, None], units, self.level)
        )
        size, slope = self.normalisation(at)
        slope = np.concatenate([slope * units.state[:, None], np.zeros((*slope.shape[:2], by_jet.shape[2]))], axis=2)
        matrix = np.concatenate([np.concatenate([by_state, by_jet], axis=2), slope], axis=1)
        with np.errstate(all="ignore"):  # points where functions overflow stay where they are
            values = np.concatenate([(at.array / units.rows)[:, :k].reshape(len(matrix), -1), size], axis=1)
            finite = (
                np.isfinite(matrix).all(axis=(1, 2))
                & np.isfinite(values).all(axis=1)
                & np.isfinite(np.sum(values**2, axis=1))
            )
        matrix, values = np.where(finite[:, None, None], matrix, 0.0), np.where(finite[:, None], values, 0.0)
        n, column = at.costate.shape[1], np.arange(matrix.shape[2])
        ease = np.where(descent & (column >= 2 * n), EASE, 1.0)
        ease = np.where(self.points.stiff[:, None] & (column >= n) & (column < 2 * n), 1 / EASE, ease)
        scale = np.concatenate([units.state, units.jet[:, :k].reshape(len(matrix), -1)], axis=1)
        step = -ease * _regularise(matrix * ease[:, None], values, descent) * scale
        return np.pad(step, ((0, 0), (0, units.both.shape[1] - step.shape[1])))


def _regularise(matrix: np.ndarray, values: np.ndarray, descent: bool) -> np.ndarray:
    """``J' (J J' + d)^+ F`` with ``d`` the square of ``F``, at most ``LARGEST_SHIFT``, in a batch.

    Converges quadratically wherever ``F`` bounds the distance to its zeros, though the rank of ``J`` may drop on them
    [Yamashita, Fukushima, On the rate of convergence of the Levenberg-Marquardt method, 2001]: steps of Gauss and
    Newton are drawn to where pieces cross. With ``descent`` ``d`` is at least the square of the largest singular value.
    """
    left, sizes, right = np.linalg.svd(matrix, full_matrices=False)
    shift = np.minimum(np.sum(values**2, axis=1), LARGEST_SHIFT)[:, None]
    shift = np.maximum(shift, sizes[:, :1] ** 2) if descent else shift
    counted = sizes > PSEUDO_INVERSE_CUTOFF * sizes[:, :1]
    filtered = np.where(counted, sizes / np.where(counted, sizes**2 + shift, 1.0), 0.0)
    return np.einsum("bri,br,bkr,bk->bi", right, filtered, left, values)
