"""Charts of a retraction around the centres of steps: coordinates of points, and of covectors, in each."""

from functools import cached_property
from typing import NamedTuple, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ....compute.base import Evaluator, PointwiseFunction
from ....manifolds.numerics import ambient as vec
from ....manifolds.numerics.tolerances import EPS, HALF
from ....retractions import Retraction
from ...problem.point_layout import PointLayout

CENTRE_ROUNDS = 30  # of Newton's method, which takes three to five


class Polynomials(NamedTuple):
    """Polynomials of some steps, through coordinates in charts at places, fractions of the step."""

    places: np.ndarray  # (j,)
    centres: np.ndarray  # (..., E)
    coordinates: np.ndarray  # (..., j, n)

    def slopes(self, at: np.ndarray) -> np.ndarray:
        """Derivatives at some places, shape ``(..., i, n)``, by the fraction of the step."""
        return np.einsum("ij,...jn->...in", _slopes(self.places, at), self.coordinates)


@final
class Chart:
    """The charts ``c -> R_x(E c)``, with the basis ``E`` of the manifold at ``x``; flat points with leading axes.

    Entries of what is outside a chart are NaN. Each function is traced when it is first needed.
    """

    def __init__(self, retraction: Retraction, evaluator: Evaluator) -> None:
        self.retraction, self.manifold, self.state = (
            retraction,
            retraction.manifold,
            PointLayout.of(retraction.manifold),
        )
        self._values, self._derivatives = evaluator.values, evaluator.derivatives

    def centres(self, near: np.ndarray, begins: np.ndarray, ends: np.ndarray) -> np.ndarray:
        """The points ``x`` amid pairs of points, ``R_x(-v)`` and ``R_x(v)`` for one ``v``, by Newton's method from
        points near.

        It ends with a move of half of the digits, whose error is rounding, or where its moves no longer shrink.
        """
        x, last = near, np.inf
        for _ in range(CENTRE_ROUNDS):
            _, _, jacobian, values = _each(self._uneven, x, begins, ends)
            n = values.shape[-1] // 2
            known = np.all(np.isfinite(jacobian), axis=(-2, -1)) & np.all(np.isfinite(values), axis=-1)
            jacobian = np.where(known[..., None, None], jacobian[..., :n, :], np.eye(n))
            move = np.where(known[..., None], -np.linalg.solve(jacobian, values[..., :n, None])[..., 0], 0.0)
            x = np.where(known[..., None], self.points(x, move), np.nan)
            largest, scale = (np.max(np.abs(a).reshape(-1, n), axis=0) for a in (move, np.nan_to_num(values[..., n:])))
            size = np.max(largest / np.where(scale > 0, scale, 1.0))
            if size <= EPS**HALF or not size < last / 2:
                return x
            last = size
        return x

    def polynomials(self, places: np.ndarray, begins: np.ndarray, states: np.ndarray, ends: np.ndarray) -> Polynomials:
        """Polynomials of time through both ends, shape ``(..., E)``, and the ``s > 1`` points at ``places``, ``(..., s,
        E)``."""
        centres = self.centres(states[..., len(places) // 2, :], begins, ends)
        inner = places < 1.0  # a point at the end of the step is the node there
        points = np.concatenate([begins[..., None, :], states[..., inner, :], ends[..., None, :]], axis=-2)
        through = np.concatenate([[0.0], places[inner], [1.0]])
        return Polynomials(through, centres, self.coordinates(centres[..., None, :], points))

    @property
    def functions(self) -> dict[str, PointwiseFunction]:
        """The functions of one point by their names, for programs that are exported."""
        return {"chart_coordinates": self._coordinates, "chart_at": self._at, "chart_uneven": self._uneven}

    def coordinates(self, centres: np.ndarray, points: np.ndarray) -> np.ndarray:
        """Coordinates of points, shape ``(..., n)``."""
        return _each(self._coordinates, centres, points)[0]

    def points(self, centres: np.ndarray, coordinates: np.ndarray) -> np.ndarray:
        """The points with some coordinates."""
        return _each(self._at, centres, coordinates)[0]

    def pullback(self, centres: np.ndarray, coordinates: np.ndarray, covectors: np.ndarray) -> np.ndarray:
        """Covectors at the points with some coordinates, ``D R_x(E c)' p``."""
        _, frames, derivatives = _each(self._at, centres, coordinates)
        return np.einsum("...ba,...be,...e->...a", derivatives, frames, covectors)

    def pushforward(self, centres: np.ndarray, coordinates: np.ndarray, momenta: np.ndarray) -> np.ndarray:
        """The covectors at these points that are ``momenta`` in the chart, shape ``(..., E)``."""
        _, frames, derivatives = _each(self._at, centres, coordinates)
        finite = np.all(np.isfinite(derivatives), axis=(-2, -1), keepdims=True)
        regular = np.where(finite, derivatives, np.eye(momenta.shape[-1]))
        covectors = np.linalg.solve(regular.mT, momenta[..., None])[..., 0]
        return np.einsum("...be,...b->...e", np.where(finite, frames, np.nan), covectors)

    @cached_property
    def _uneven(self) -> PointwiseFunction:
        """Sum and difference of the coordinates of two points, and the derivatives by coordinates of the centre."""

        def uneven(d: Array, x: Array, begin: Array, end: Array) -> tuple[Array, Array]:
            centre = self.state.point(x)
            frame = self.manifold.basis(centre)
            moved = self.retraction(centre, vec.combine(frame, d))
            a, b = (vec.components(frame, self.retraction.preimage(moved, self.state.point(q))) for q in (begin, end))
            return jnp.zeros(()), jnp.concatenate([a + b, b - a])

        size = self.state.size
        return self._derivatives(uneven, self.manifold.dimension, size, size, size)

    @cached_property
    def _coordinates(self) -> PointwiseFunction:
        def coordinates(x: Array, q: Array) -> tuple[Array]:
            centre = self.state.point(x)
            return (vec.components(self.manifold.basis(centre), self.retraction.preimage(centre, self.state.point(q))),)

        return self._values(coordinates, self.state.size, self.state.size)

    @cached_property
    def _at(self) -> PointwiseFunction:
        def at(x: Array, c: Array) -> tuple[Array, Array, Array]:
            centre = self.state.point(x)
            frame = self.manifold.basis(centre)
            q, push = jax.linearize(lambda c: self.retraction(centre, vec.combine(frame, c)), c)
            there = self.manifold.basis(q)
            derivative = jax.vmap(lambda a: vec.components(there, push(a)))(jnp.eye(c.size))
            return self.state.flat(q), self.state.flat_frame(there), derivative.T

        return self._values(at, self.state.size, self.manifold.dimension)


def _each(function: PointwiseFunction, *arguments: np.ndarray) -> tuple[np.ndarray, ...]:
    return function.at(arguments[0].ndim - 1, *arguments)


def lagrange(places: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Values at times, shape ``(..., j)``, of the polynomials that are 1 at one place and 0 at all other places."""
    others = places[:, None] - places + np.eye(len(places))
    return np.prod(np.where(np.eye(len(places)), 1.0, (times[..., None, None] - places) / others), axis=-1)


def _slopes(places: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Derivatives of these polynomials, shape ``(at, j)``."""
    apart, same = places[:, None] - places + np.eye(len(places)), np.eye(len(places), dtype=bool)
    found = np.zeros((len(at), len(places)))
    for k in range(len(places)):
        rest = np.where(same | same[k], 1.0, (at[:, None, None] - places) / apart)
        found += np.where(same[k], 0.0, np.prod(rest, axis=-1) / apart[:, k])
    return found
