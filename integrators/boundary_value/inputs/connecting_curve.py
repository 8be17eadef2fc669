"""The curve that connects two points, for first guesses: the curve of a retraction, or a walk."""

from functools import cached_property
from typing import final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ....compute.automatic import AutomaticEvaluator
from ....compute.base import Evaluator, PointwiseFunction
from ....compute.tape_evaluator import TapeEvaluator
from ....manifolds import DomainError, Manifold
from ....manifolds.numerics import ambient as vec
from ....manifolds.numerics.ambient import Ambient
from ....manifolds.numerics.precision import default_tolerance
from ....retractions import Retraction, default_retraction
from ...problem.point_layout import PointLayout

ASIDE = 0.05  # of the chord
CURVE_PIECES = 8  # of a curve, in which its unevenness is measured: it does not depend on the steps of a method
ENDS = np.linspace(0.0, 1.0, CURVE_PIECES + 1)  # of these
UNEVEN = 2.0  # times the mean step: the Cayley map takes most of a turn by nearly 180 degrees in its first steps

Curve = tuple[PointwiseFunction, PointwiseFunction]  # the vector from a start to an end, with its size; points along it


@final
class ConnectingCurve:
    """States between two points.

    They lie on the curve of the default retraction of the manifold, a geodesic where that is known; where it does not
    arrive, or in very unequal steps, on that of the given retraction. Where no tape gives the default one, as on
    Stiefel manifolds, whose logarithm is an iteration, the given one is tried first. Where the two points are opposite
    to each other, as attitudes half a turn apart, a walk sets out in a direction that is random but always the same:
    there are several ways round, and this is one of them.
    """

    def __init__(self, manifold: Manifold, retraction: Retraction) -> None:
        self.manifold, self.layout, self.retraction = manifold, PointLayout.of(manifold), retraction
        self._default, self._tapes, self._evaluator = (
            default_retraction(manifold),
            TapeEvaluator(),
            AutomaticEvaluator(),
        )
        self._walk: Curve | None = None

    def states(self, starts: np.ndarray, ends: np.ndarray, fractions: np.ndarray) -> np.ndarray:
        """Flat states, shape (B, K, E), at ascending fractions of the way between flat points, shape (B, E).

        Raises ``DomainError`` if no way arrives near an end.
        """
        states, arrived = self._along(self._quick or self._curve_of_method, starts, ends, fractions)
        for way in (self._again, self._follow_chord):
            if arrived.all():
                return states
            missing = np.flatnonzero(~arrived)
            states[missing], arrived[missing] = way(starts[missing], ends[missing], fractions)
        if not arrived.all():
            raise DomainError(
                "no default guess: the walk from start to end does not arrive; pass a guess that goes through points "
                "between"
            )
        return states

    def _again(self, *way: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return self._along(self._curve_of_method if self._quick else self._slow, *way)

    def _along(
        self, curve: Curve, starts: np.ndarray, ends: np.ndarray, fractions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Points of a curve; and whether they arrive, in even steps."""
        leave, go = curve
        vectors, lengths = leave.at(1, starts, ends)
        (points,) = go.at(2, starts[:, None], vectors[:, None], np.concatenate([ENDS, fractions])[None, :, None])
        states = points[:, len(ENDS) :]
        arrived = np.isfinite(lengths) & self._even(points[:, : len(ENDS)])
        return states, arrived & np.isfinite(states).all(axis=(1, 2))

    @cached_property
    def _quick(self) -> Curve | None:
        """The curve of the default retraction, if tapes give it; what else is wrong with it is told where it is
        needed."""
        try:
            return self._curve(self._default, self._tapes)
        except Exception:  # one of a user's own may raise anything
            return None

    @cached_property
    def _slow(self) -> Curve:
        return self._curve(self._default, self._evaluator)

    @cached_property
    def _curve_of_method(self) -> Curve:
        return self._curve(self.retraction, self._evaluator)

    def _curve(self, retraction: Retraction, evaluator: Evaluator) -> Curve:
        """The curve ``s -> R(start, s v)``, ``R(start, v) = end``."""

        def leave(start: Array, end: Array) -> tuple[Array, Array]:
            v = retraction.preimage(self.layout.point(start), self.layout.point(end))
            return self.layout.flat(v), vec.size(v)

        def go(start: Array, vector: Array, s: Array) -> tuple[Array]:
            return (self.layout.flat(retraction(self.layout.point(start), vec.scale(s[0], self.layout.point(vector)))),)

        size = self.layout.size
        return evaluator.values(leave, size, size), evaluator.values(go, size, size, 1)

    def _even(self, points: np.ndarray) -> np.ndarray:
        """Whether the largest step between finite points is at most ``UNEVEN`` times the mean step, in each array."""
        change, arrays = points[:, 1:] - points[:, :-1], self.layout.in_arrays.T
        lengths = np.sqrt((change * change) @ arrays)
        size = np.sqrt(((points * points) @ arrays).max(axis=1, initial=0.0))
        even = UNEVEN / CURVE_PIECES * lengths.sum(axis=1) + default_tolerance() * size
        return (lengths.max(axis=1) <= even).all(axis=1)

    def _follow_chord(
        self, starts: np.ndarray, ends: np.ndarray, fractions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """A walk along the chord's tangential part, each time the share of its length that is due; and whether it
        arrives.

        It begins a little beside the start, because the chord to an opposite point has no tangential part.
        """
        if self._walk is None:
            size, aside = (
                self.layout.size,
                jax.tree.map(np.asarray, vec.normal(jax.random.key(0), self.manifold.ambient)),
            )
            begin = self._evaluator.values(lambda *ends: self._leave_start(aside, *ends), size, size)
            self._walk = begin, self._evaluator.values(self._go, size, size, 1)
        (x,) = self._walk[0].at(1, starts, ends)
        states, behind = [], 0.0
        for fraction in fractions:
            share = np.full((len(starts), 1), (fraction - behind) / (1 - behind) if behind < 1 else 0.0)
            (x,) = self._walk[1].at(1, x, ends, share)
            states.append(x)
            behind = fraction
        way = np.linalg.norm(starts - ends, axis=1)
        return np.stack(states, axis=1), np.linalg.norm(x - ends, axis=1) < way / 2

    def _leave_start(self, aside: Ambient, start: Array, end: Array) -> tuple[Array]:
        x, y = self.layout.point(start), self.layout.point(end)
        chord = vec.subtract(y, x)
        aside = self.manifold.projection(x, aside)
        aside = self.manifold.projection(x, jax.tree.map(lambda a, c: ASIDE * vec.size(c) * a, aside, chord))
        return (self.layout.flat(self.retraction(x, aside)),)

    def _go(self, start: Array, end: Array, share: Array) -> tuple[Array]:
        x, y = self.layout.point(start), self.layout.point(end)

        def as_long(v: Array, chord: Array) -> Array:
            length = jnp.linalg.norm(v)
            return jnp.where(length > 0, jnp.linalg.norm(chord) / jnp.where(length > 0, length, 1.0), 0.0) * v

        chord = vec.subtract(y, x)
        along = self.manifold.projection(x, jax.tree.map(as_long, self.manifold.projection(x, chord), chord))
        return (self.layout.flat(self.retraction(x, vec.scale(share[0], along))),)
