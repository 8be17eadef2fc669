"""Boundary conditions: a node of the trajectory that is fixed, free, or fixed in some factors of a product."""

from collections.abc import Iterator
from typing import Any, NamedTuple, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ...manifolds import InvalidInputError, Manifold, NotOnManifoldError, Product
from ...manifolds.manifold import default_tolerance
from ...manifolds.numerics.ambient import Ambient
from ..compilation import call_compiled
from ..free import guessed, is_free
from ..problem import resting_control


class Part(NamedTuple):
    """A part of a point that is prescribed or free as a whole: a manifold, or a factor of a product, in words."""

    name: str
    fixed: bool
    leaves: int
    dimension: int


class _Given(NamedTuple):
    """A point of a manifold or of a factor of it, None where it is free, and what it is called."""

    name: str
    manifold: Manifold
    given: Any

    @property
    def described(self) -> Part:
        """The part without its point."""
        leaves = len(jax.tree.leaves(self.manifold.ambient))
        return Part(self.name, not (self.given is None or is_free(self.given)), leaves, self.manifold.dimension)


@final
class NodeCondition(eqx.Module):
    """The condition on the first or last node.

    ``point`` holds the prescribed entries, and a first guess for the free ones. ``parts`` says which of its arrays are
    prescribed, in the order of the arrays and of the coordinates in the basis of the tangent space.
    """

    point: Ambient
    parts: tuple[Part, ...] = eqx.field(static=True)

    @property
    def fixed_leaves(self) -> tuple[bool, ...]:
        """Which arrays of the point are prescribed."""
        return tuple(part.fixed for part in self.parts for _ in range(part.leaves))

    @property
    def fixed_coordinates(self) -> tuple[bool, ...]:
        """Which coordinates in the basis of the tangent space are prescribed."""
        return tuple(part.fixed for part in self.parts for _ in range(part.dimension))

    def node(self, reached: Ambient) -> Ambient:
        """The node: prescribed where fixed, the reached end of the stage where free."""
        wanted, structure = jax.tree.flatten(self.point)
        leaves = [w if fixed else r for w, r, fixed in zip(wanted, jax.tree.leaves(reached), self.fixed_leaves, strict=True)]
        return jax.tree.unflatten(structure, leaves)

    def mask(self) -> Array:
        """1 for every fixed coordinate, 0 for every free one."""
        return jnp.asarray(self.fixed_coordinates, float)


def require_ends_on(manifold: Manifold, start: Any, end: Any) -> None:
    """Raise ``NotOnManifoldError`` if a prescribed part of an end is off its manifold."""
    parts = [part for name, given in (("start", start), ("end", end)) for part in _parts(manifold, given, name)]
    _require_membership([part for part in parts if part.given is not None and not is_free(part.given)])


def boundary_conditions(manifold: Manifold, start: Any, end: Any, guided: bool) -> tuple[NodeCondition, NodeCondition]:
    """Conditions at both ends from points of the manifold in which ``None`` marks what is free.

    A free factor is first guessed equal to the one at the other end; free at both ends it is at rest, or zero if ``guided`` by a
    guess for the whole trajectory. Raises ``NotOnManifoldError`` for a part of another structure than a point.
    """
    at_start, at_end = (list(_parts(manifold, given, name)) for name, given in (("start", start), ("end", end)))
    first, last = _merge(manifold, start, end), _merge(manifold, end, start)
    return (
        NodeCondition(_fill(manifold, first, guided), tuple(part.described for part in at_start)),
        NodeCondition(_fill(manifold, last, guided), tuple(part.described for part in at_end)),
    )


def require_known_ends(manifold: Manifold, start: Any, end: Any) -> None:
    """Raise if a factor is free at both ends, so that there is nothing to guess it from."""
    merged = _merge(manifold, start, end)
    if any(leaf is None for leaf in jax.tree.leaves(merged, is_leaf=lambda leaf: leaf is None)):
        raise InvalidInputError(f"start = {start!r} leaves a factor free that is free at the other end too; pass a guess")


def _merge(manifold: Manifold, given: Any, other: Any) -> Any:
    """``given`` with the entries of ``other`` where it is None."""
    if isinstance(manifold, Product) and (isinstance(given, tuple | list) or isinstance(other, tuple | list)):
        count = len(manifold.factors)
        mine = given if isinstance(given, tuple | list) else (given,) * count
        theirs = other if isinstance(other, tuple | list) else (other,) * count
        if len(mine) == len(theirs) == count:
            return tuple(_merge(m, a, b) for m, a, b in zip(manifold.factors, mine, theirs, strict=True))
    return guessed(other if given is None else given)


def _parts(manifold: Manifold, given: Any, name: str) -> Iterator[_Given]:
    """The parts of a point, after a check of the structure of every prescribed one."""
    if isinstance(manifold, Product) and isinstance(given, tuple | list) and len(given) == len(manifold.factors):
        for i, (factor, part) in enumerate(zip(manifold.factors, given, strict=True)):
            yield from _parts(factor, part, f"{name}, factor {i}")
        return
    wrong = "" if given is None else manifold.describe_mismatch(guessed(given), "a point")
    if wrong:
        hint = "; give one entry for each factor, None where it is free" if isinstance(manifold, Product) else ""
        raise NotOnManifoldError(f"{name}: {wrong}{hint}")
    yield _Given(name, manifold, given)


def _require_membership(parts: list[_Given]) -> None:
    """Raise for a part that is off its manifold; all are looked at in one compiled function."""
    points = [jax.tree.map(np.asarray, part.given) for part in parts]
    found, *_ = call_compiled(_violations, [part.manifold for part in parts], points)
    for part, violations in zip(parts, jax.tree.map(np.asarray, found), strict=True):
        verdict = part.manifold.judge(violations, default_tolerance())
        if not verdict:
            raise NotOnManifoldError(f"{part.name}: {verdict.reason}")


def _violations(manifolds: list[Manifold], points: list[Ambient]) -> list[dict[str, Array]]:
    return [manifold.violations(point) for manifold, point in zip(manifolds, points, strict=True)]


def _fill(manifold: Manifold, merged: Any, guided: bool) -> Ambient:
    """Arrays in the structure of a point; where nothing is known, zero if ``guided``, else a point at rest."""
    if isinstance(manifold, Product) and (merged is None or isinstance(merged, tuple | list)):
        parts = (None,) * len(manifold.factors) if merged is None else merged
        return tuple(_fill(factor, part, guided) for factor, part in zip(manifold.factors, parts, strict=True))
    if merged is None and not guided:
        return resting_control(manifold)
    if merged is None:
        return jax.tree.map(lambda s: np.zeros(s.shape, s.dtype), manifold.ambient)
    return jax.tree.map(lambda a, s: np.asarray(a, s.dtype), merged, manifold.ambient)
