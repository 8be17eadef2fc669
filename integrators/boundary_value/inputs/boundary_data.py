"""The ends of trajectories: points that are prescribed, free, or prescribed in some factors of a product."""

from collections.abc import Iterator, Sequence
from functools import cached_property
from typing import Any, NamedTuple, Self, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ....compute.at_points import judge_point
from ....manifolds import InvalidInputError, Manifold, NotOnManifoldError, Product
from ....manifolds.numerics import ambient as vec
from ....manifolds.numerics.ambient import Ambient
from ....manifolds.product import factor_name
from ...problem.free_quantities import Free, guess_of, is_free
from ...problem.initial_controls import resting_control
from ...problem.optimal_control_problem import OptimalControlProblem
from ...problem.point_layout import PointLayout
from ...problem.quantities import Quantities
from ...reporting.text import brief


class EndPart(NamedTuple):
    """A part of a point that is prescribed or free as a whole: a manifold, or a factor of a product, in words.

    ``leaves``: the number of its arrays; ``entries``: of real numbers in these.
    """

    name: str
    fixed: bool
    leaves: int
    entries: int
    dimension: int


@final
class NodeCondition(eqx.Module):
    """The condition on the first or last node.

    ``point`` holds the prescribed entries, and a first guess for the free ones. ``parts`` says which of its arrays are
    prescribed, in the order of the arrays and of the coordinates in the basis of the tangent space.
    """

    point: Ambient
    parts: tuple[EndPart, ...] = eqx.field(static=True)

    @property
    def fixed_leaves(self) -> tuple[bool, ...]:
        """Whether each array of the point is prescribed."""
        return tuple(part.fixed for part in self.parts for _ in range(part.leaves))

    def node(self, reached: Ambient) -> Ambient:
        """The node: prescribed where fixed, the reached end of the stage where free."""
        wanted, structure = jax.tree.flatten(self.point)
        leaves = [
            w if fixed else r for w, r, fixed in zip(wanted, jax.tree.leaves(reached), self.fixed_leaves, strict=True)
        ]
        return jax.tree.unflatten(structure, leaves)

    def mask(self) -> Array:
        """1 for every fixed coordinate, 0 for every free one."""
        return jnp.asarray(_of_parts([part.fixed for part in self.parts], self.parts, "dimension"), float)


class PrescribedEnd(NamedTuple):
    """The prescription of an end: its parts, its entries of a flat point, and 1 for each prescribed coordinate, else 0.

    ``known``: which entries are prescribed, or free and guessed. ``whole``: whether all are prescribed.
    """

    parts: tuple[EndPart, ...]
    entries: np.ndarray
    coordinates: np.ndarray
    known: np.ndarray
    whole: bool

    @classmethod
    def of(cls, parts: tuple[EndPart, ...], known: Sequence[bool]) -> "PrescribedEnd":
        """The prescription of an end by its parts, of which some are known."""
        fixed = [part.fixed for part in parts]
        coordinates = _of_parts(fixed, parts, "dimension").astype(float)
        entries, guessed_too = (_of_parts(marks, parts, "entries") for marks in (fixed, known))
        return cls(parts, entries, coordinates, guessed_too, all(fixed))


def _of_parts(marks: Sequence[bool], parts: tuple[EndPart, ...], what: str) -> np.ndarray:
    """The mark of each part for all of its entries or coordinates."""
    return np.repeat(marks, [getattr(part, what) for part in parts])


class EndPoints(NamedTuple):
    """Ends of trajectories as flat points, shape (B, E), or (1, E) for all, and what is prescribed of each.

    What is free at one end is as it is guessed with ``Free``, else as at the other; the entries of which neither end
    says anything are ``unknown``.
    """

    start: np.ndarray
    end: np.ndarray
    prescribed: tuple[PrescribedEnd, PrescribedEnd]
    unknown: np.ndarray

    def complete(self, first: np.ndarray, last: np.ndarray) -> "EndPoints":
        """The ends with entries of these flat points where they are unknown."""
        return self._replace(
            start=np.where(self.unknown, first, self.start), end=np.where(self.unknown, last, self.end)
        )

    def require_known(self, start: Any) -> None:
        """Raise if a factor is free at both ends, so that there is nothing to guess it from; ``start`` is as it was
        given."""
        if self.unknown.any():
            raise InvalidInputError(
                f"start = {start!r} leaves a factor free that is free at the other end too; pass a guess"
            )


@final
class BoundaryDataReader:
    """Reads points of a manifold in which ``None`` or a ``Free`` guess marks what is free, or batches of them."""

    def __init__(self, manifold: Manifold, quantities: Quantities | None = None) -> None:
        self.manifold, self.quantities, self.layout = manifold, quantities, PointLayout.of(manifold)
        self.dimension = manifold.dimension
        self.factors = tuple(map(BoundaryDataReader, manifold.factors)) if isinstance(manifold, Product) else ()
        self._prescribed: dict[Any, PrescribedEnd] = {}
        self._of_points: dict[str, PrescribedEnd] = {}  # by whole points, at the end of this name

    @classmethod
    def of(cls, problem: OptimalControlProblem) -> Self:
        """The reader of the states of a problem, with its labels in messages."""
        return cls(problem.manifold, problem.quantities)

    @cached_property
    def at_rest(self) -> np.ndarray:
        """A flat point to begin from where nothing is known."""
        return self.layout.rows(resting_control(self.manifold), 0)

    def ends(self, start: Any, end: Any, batched: bool) -> EndPoints:
        """Both ends. Raises ``NotOnManifoldError`` for a part of another structure than a point, with entries not
        finite."""
        first, start_rows = self._read(start, "start", batched)
        last, end_rows = self._read(end, "end", batched)
        if first.whole and last.whole and len(start_rows) == len(end_rows):
            return EndPoints(start_rows, end_rows, (first, last), np.zeros(self.layout.size, bool))
        rows = np.where(first.known, start_rows, end_rows), np.where(last.known, end_rows, start_rows)
        return EndPoints(*rows, (first, last), ~(first.known | last.known))

    def point(self, given: Any) -> np.ndarray:
        """A flat point, nothing of which is free. Raises ``NotOnManifoldError`` for what is none."""
        ends = self.ends(given, None, batched=False)
        if not np.all(ends.prescribed[0].entries):
            raise NotOnManifoldError(f"start: a part of {brief(given)} is free, expected a point of {self.manifold}")
        self.require_on_manifold(given, None)
        return ends.start[0]

    def lengths(self, given: Any) -> list[tuple[int, ...]]:
        """Lengths of the leading axes that points have in addition."""
        if given is None:
            return []
        given = self._array(given)
        if self._is_split(given):
            return [length for factor, part in zip(self.factors, given, strict=True) for length in factor.lengths(part)]
        return [np.shape(jax.tree.leaves(guess_of(given))[0])[:1]] if self._is_batch(guess_of(given)) else []

    def member(self, given: Any, k: int) -> Any:
        """Member ``k`` of what may be a batch of points."""
        if given is None:
            return None
        given = self._array(given)
        if self._is_split(given):
            return tuple(factor.member(part, k) for factor, part in zip(self.factors, given, strict=True))
        if not self._is_batch(guess_of(given)):
            return given
        return given.member(k) if isinstance(given, Free) else vec.taken(given, k)

    def require_on_manifold(self, start: Any, end: Any, whose: str = "") -> None:
        """Raise ``NotOnManifoldError`` if a prescribed part of an end is off its manifold; ``whose`` names the member
        of a batch."""
        parts = [given for name, at in (("start", start), ("end", end)) for given in self._parts(at, name)]
        _require_membership(
            [(f"{name}{whose}", reader.manifold, point) for name, reader, point in parts if _is_prescribed(point)]
        )

    def condition(self, row: np.ndarray, parts: tuple[EndPart, ...]) -> NodeCondition:
        """The condition on a node from a flat point."""
        return NodeCondition(self.layout.point_arrays(row), parts)

    def _is_split(self, given: Any) -> bool:
        """Whether the factors of a product are given one by one."""
        return bool(self.factors) and isinstance(given, tuple | list) and len(given) == len(self.factors)

    def _is_batch(self, given: Any) -> bool:
        return [np.ndim(leaf) for leaf in jax.tree.leaves(given)] == [len(shape) + 1 for shape in self.layout.shapes]

    def _parts(self, given: Any, name: str) -> Iterator[tuple[str, "BoundaryDataReader", Any]]:
        """Names of the parts of a point, readers of them, and what is given, None or a guess where it is free."""
        if self._is_split(given):
            count = len(self.factors)
            names = map(factor_name, range(count)) if self.quantities is None else self.quantities.factors(count)
            for own, factor, part in zip(names, self.factors, given, strict=True):
                yield from factor._parts(part, f"{name}, {own}")
        else:
            yield name, self, self._array(given)

    def _array(self, given: Any) -> Any:
        """The array that nested lists of numbers stand for, where a point is one array; anything else as it is."""
        if self.factors or len(self.layout.shapes) != 1 or not isinstance(given, list | tuple | int | float):
            return given
        if not all(isinstance(leaf, int | float | complex) for leaf in jax.tree.leaves(given)):
            return given
        try:
            array = np.asarray(given)
        except ValueError:  # rows of several lengths
            return given
        return array.reshape(self.layout.shapes[0]) if array.ndim == 0 and self.layout.size == 1 else array

    def _read(self, given: Any, name: str, batched: bool) -> tuple[PrescribedEnd, np.ndarray]:
        """The prescription of an end, and its flat points, with zeros where nothing is known."""
        whole = None if batched else self.layout.finite_rows(given, 0)
        if whole is not None:
            if name not in self._of_points:
                self._of_points[name] = self._prescription(list(self._parts(given, name)))
            return self._of_points[name], whole[None]
        found = list(self._parts(given, name))
        rows = [reader._rows(guess_of(point), title, batched) for title, reader, point in found]
        count = max(map(len, rows))
        rows = rows if count == 1 else [np.broadcast_to(part, (count, part.shape[1])) for part in rows]
        return self._prescription(found), np.concatenate(rows, axis=1)

    def _prescription(self, found: Sequence[tuple[str, "BoundaryDataReader", Any]]) -> PrescribedEnd:
        """The prescription of an end by its parts."""
        key = tuple((title, _is_prescribed(point), point is not None) for title, _, point in found)
        if key not in self._prescribed:
            own = ((len(reader.layout.shapes), reader.layout.size, reader.dimension) for _, reader, _ in found)
            parts = tuple(EndPart(*of[:2], *counts) for of, counts in zip(key, own, strict=True))
            self._prescribed[key] = PrescribedEnd.of(parts, [known for _, _, known in key])
        return self._prescribed[key]

    def _rows(self, given: Any, name: str, batched: bool) -> np.ndarray:
        """Flat points of what is given for a part, after a check of its structure; zeros for None."""
        if given is None:
            return np.zeros((1, self.layout.size))
        axes = int(batched and self._is_batch(given))
        rows = self.layout.finite_rows(given, axes)
        if rows is None:
            hint = "; give one entry for each factor, None where it is free" if self.factors else ""
            count = len(jax.tree.leaves(given)[0]) if axes else 1
            for k in range(count):
                wrong = self.manifold.describe_mismatch(self.member(given, k) if axes else given, "a point")
                if wrong:
                    raise NotOnManifoldError(f"{name}{f', member {k}' if count > 1 else ''}: {wrong}{hint}")
            rows = self.layout.rows(given, axes)
        return rows if axes else rows[None]


def _is_prescribed(given: Any) -> bool:
    return not (given is None or is_free(given))


def _require_membership(parts: list[tuple[str, Manifold, Ambient]]) -> None:
    """Raise for a part that is off its manifold."""
    for name, manifold, point in parts:
        verdict = judge_point(manifold, point)
        if not verdict:
            raise NotOnManifoldError(f"{name}: {verdict.reason}")
