"""Affine hulls of pieces of ``P_f``: linear equations that hold on one piece and not on the pieces that cross it."""

from typing import Self, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ....manifolds.numerics import ambient as vec
from ....manifolds.numerics.precision import default_tolerance
from .algorithm_stages import StoppedPoints
from .derivative_array import Pair
from .final_equations import FinalEquations
from .sample_points import Points

SAME_DIRECTION = 1e-9  # largest difference of directions that are the same, in units
APART = 1e-7  # larger differences of directions are clear: between, a curved piece may be nearly flat
FEWEST_POINTS = 3  # points that show a piece


@final
class AffineHull(eqx.Module):
    """The least affine subspace of the ambient space that holds a piece, ``normals @ z = levels`` in units."""

    normals: Float[Array, "k N"]
    levels: Float[Array, " k"]

    def __call__(self, z: Pair) -> Float[Array, " k"]:
        """Values of its equations."""
        return self.normals @ _flat(z) - self.levels

    def holds(self, z: Pair) -> Bool[Array, ""]:
        """Whether a point lies in it, to half of the digits."""
        sizes = jnp.abs(self.normals) @ jnp.abs(_flat(z)) + jnp.abs(self.levels)
        return jnp.all(jnp.abs(self(z)) <= default_tolerance() * (1 + sizes))

    @classmethod
    def of(cls, members: list[StoppedPoints]) -> Self | None:
        """The hull of a piece from points of it and tangent spaces there; None if these leave out no direction.

        That is known where one point less shows the same. What vanishes all over ``T*Q`` is left out.
        """
        if len(members) < FEWEST_POINTS or any(item.points.slow.any() for item in members):
            return None
        sizes = members[0].points.sizes.state
        frames = [sizes[:, None] * _rows(vec.taken(item.points.at.frame, 0)) for item in members]
        extent = np.max([np.linalg.norm(frame, axis=0) for frame in frames], axis=0)
        extent = np.where(extent > 0, extent, 1.0)
        along = [item.ranks.tangents.T @ frame / extent for item, frame in zip(members, frames, strict=True)]
        places = [np.asarray(_flat(vec.taken(item.points.at.z, 0))) for item in members]
        apart = [(place - places[0]) / extent for place in places[1:]]
        basis, fewer = (
            _normals(np.concatenate([*along[:n], apart[: n - 1]])) for n in (len(members), len(members) - 1)
        )
        if basis is None or fewer is None or not len(basis) == len(fewer) > 0:
            return None
        left, seen, _ = np.linalg.svd(basis @ (frames[0] / extent).T)
        normals = left.T[: int(np.sum(seen > APART))] @ basis / extent
        return cls(jnp.asarray(normals), jnp.asarray(normals @ places[0])) if len(normals) else None

    def rows(self, points: Points) -> np.ndarray:
        """Derivatives of the equations along the state at the one point of a batch, in units."""
        return np.asarray(self.normals) @ (points.units.state[0][:, None] * _rows(vec.taken(points.at.frame, 0))).T


@final
class PieceEquations(eqx.Module):
    """Independent equations of a piece: the equations of its hull, and as many of ``P_f`` as are missing.

    They vanish on no piece that leaves the hull, and do not degenerate where one crosses.
    """

    hull: AffineHull
    equations: FinalEquations
    beside: tuple[int, ...] = eqx.field(static=True)

    def __call__(self, z: Pair) -> Float[Array, " codimension"]:
        """Their values."""
        others = self.equations(z)[jnp.asarray(self.beside)] if self.beside else jnp.zeros(0)
        return jnp.concatenate([self.hull(z), others])


def piece_equations(hull: AffineHull, equations: FinalEquations, points: Points) -> PieceEquations:
    """The equations of the piece through the one point of a batch, from the ``equations`` of ``P_f``."""
    rows, count = equations.conormals(points), len(hull.normals)
    chosen, beside = list(np.linalg.qr(hull.rows(points).T)[0].T), list[int]()
    rows = rows / np.linalg.norm(rows, axis=1, keepdims=True)
    while count + len(beside) < len(rows):
        taken = np.array(chosen)
        rest = rows - rows @ taken.T @ taken
        best = int(np.argmax(np.linalg.norm(rest, axis=1)))
        chosen.append(rest[best] / np.linalg.norm(rest[best]))
        beside.append(best)
    return PieceEquations(hull, equations, tuple(sorted(beside)))


def _normals(vectors: np.ndarray) -> np.ndarray | None:
    """An orthonormal basis of what is normal to vectors, in rows; None where their rank is not clear."""
    lengths = np.linalg.norm(vectors, axis=1, keepdims=True)
    _, values, right = np.linalg.svd(vectors / np.where(lengths > SAME_DIRECTION, lengths, np.inf))
    if np.any((values > SAME_DIRECTION) & (values <= APART)):
        return None
    return right[int(np.sum(values > SAME_DIRECTION)) :]


def _flat(z: Pair) -> Array:
    return vec.flatten_frame(jax.tree.map(lambda leaf: jnp.asarray(leaf)[None], z))[0]


def _rows(frame: Pair) -> np.ndarray:
    return np.asarray(vec.flatten_frame(frame))
