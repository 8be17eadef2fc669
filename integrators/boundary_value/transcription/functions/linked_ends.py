"""The functions of the ends of phases: their costs, and the equations between them."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .....compute.base import Evaluator, PointwiseFunction
from .....manifolds import Manifold
from .....manifolds.numerics import ambient as vec
from .....manifolds.numerics.ambient import Ambient
from ....problem.optimal_control_problem import OptimalControlProblem
from ....problem.point_layout import PointLayout, parameter_layout


class Link(NamedTuple):
    """An equation ``image(source) = state(target)`` between two ends; phase k begins at end ``2 k``, stops at ``2 k +
    1``.

    ``image`` takes the state at the source and the parameters there, ``state`` the state at the target; both return
    points of the manifold.
    """

    manifold: Manifold
    source: int
    target: int
    image: Callable[[Any, Any], Ambient]
    state: Callable[[Any], Ambient]


class LinkedEnds(NamedTuple):
    """The equations at the ends of the phases, and derivatives in their frames; Z coordinates of all ends."""

    values: np.ndarray  # (B, r)
    jacobian: np.ndarray  # (B, r, Z): of the equations
    slope: np.ndarray  # (B, Z): of the costs of the ends, and of the multipliers times the equations


@final
class LinkageFunctions:
    """The costs of the ends of P phases and the equations between them, traced once as the ``function`` of the core.

    ``equations`` of all ends and of the parameters of all phases return numbers that are to vanish. There is a
    multiplier of each equation, then for each link a covector at its target, so that ``L = costs + mu . b + sum <P,
    g(source) - target>``.
    """

    def __init__(
        self,
        problems: Sequence[OptimalControlProblem],
        parameters: Sequence[Any],
        equations: Callable[[list[Any], list[Any]], Array],
        links: Sequence[Link],
        evaluator: Evaluator,
    ) -> None:
        self.problems, self.equations, self.links = problems, equations, tuple(links)
        self.layouts = [PointLayout.of(problem.manifold) for problem in problems for _ in range(2)]
        self.given = [parameter_layout(given) for given in parameters]
        self.dimensions = [problem.manifold.dimension for problem in problems for _ in range(2)]
        self.count = self._count()
        self.sizes = [self.count, *(PointLayout.of(link.manifold).size for link in self.links)]
        sizes = [*(layout.size for layout in self.layouts), *(layout.size for layout in self.given), sum(self.sizes)]
        self.function: PointwiseFunction = evaluator.derivatives(self._of, sum(self.dimensions), *sizes)

    @property
    def rows(self) -> int:
        """Number of the equations, with the coordinates of links."""
        return self.count + sum(link.manifold.dimension for link in self.links)

    def __call__(
        self, ends: Sequence[np.ndarray], parameters: Sequence[np.ndarray], multipliers: np.ndarray
    ) -> LinkedEnds:
        """The equations at flat ends, each (B, E), with multipliers (B, M)."""
        _, slope, jacobian, values, *_ = self.function.at(1, *ends, *parameters, multipliers)
        return LinkedEnds(values, jacobian, slope)

    def lift(self, coordinates: np.ndarray, frames: Sequence[np.ndarray]) -> np.ndarray:
        """Multipliers as they are kept, from their coordinates in the frames at all ends, each (B, n, E)."""
        found, begin = [coordinates[:, : self.count]], self.count
        for link, size in zip(self.links, self.sizes[1:], strict=True):
            end = begin + link.manifold.dimension
            frame = frames[link.target][:, : end - begin, :size]  # what is added to a state comes after it
            found.append(np.einsum("bn,bne->be", coordinates[:, begin:end], frame))
            begin = end
        return np.concatenate(found, axis=1)

    def _count(self) -> int:
        points = [
            jax.tree.map(lambda s: jnp.zeros(s.shape, s.dtype), problem.manifold.ambient) for problem in self.problems
        ]
        given = [layout.point(jnp.zeros(layout.size)) for layout in self.given]
        return jax.eval_shape(self.equations, [p for p in points for _ in range(2)], given).shape[0]

    def _of(self, z: Array, *flat: Array) -> tuple[Array, ...]:
        total = len(self.layouts)
        points = [layout.point(a) for layout, a in zip(self.layouts, flat, strict=False)]
        given = [layout.point(a) for layout, a in zip(self.given, flat[total:], strict=False)]
        cuts = np.cumsum([0, *self.dimensions])
        manifolds = [problem.manifold for problem in self.problems for _ in range(2)]
        moved = [
            vec.add(point, vec.combine(manifold.basis(point), z[a:b]))
            for point, manifold, a, b in zip(points, manifolds, cuts[:-1], cuts[1:], strict=True)
        ]
        frames = [link.manifold.basis(link.state(points[link.target])) for link in self.links]
        held = self._coordinates(flat[-1], frames)

        def lagrangian(ends: list[Any]) -> tuple[Array, tuple[Array, Array]]:
            rows, costs = self._rows(ends, given, frames), self._costs(ends, given)
            return jnp.sum(costs) + held @ rows, (rows, costs)

        value, (rows, _) = lagrangian(moved)
        derivative = vec.gradient(lambda ends: lagrangian(ends)[0], points)
        flat_derivative = jnp.concatenate([layout.flat(p) for layout, p in zip(self.layouts, derivative, strict=True)])
        apart = jnp.concatenate(
            [jnp.zeros(0), *(PointLayout.of(k.manifold).flat(self._apart(k, points, given)) for k in self.links)]
        )
        return value, rows, flat_derivative, apart, self._costs(points, given), held

    def _coordinates(self, multipliers: Array, frames: list[Any]) -> Array:
        """Multipliers of the equations, and of the links in frames at their targets."""
        own, begin = [multipliers[: self.count]], self.count
        for link, frame, size in zip(self.links, frames, self.sizes[1:], strict=True):
            covector = PointLayout.of(link.manifold).point(multipliers[begin : begin + size])
            own.append(vec.components(frame, covector))
            begin += size
        return jnp.concatenate(own)

    def _rows(self, ends: list[Any], given: list[Any], frames: list[Any]) -> Array:
        own = [
            vec.components(frame, self._apart(link, ends, given))
            for link, frame in zip(self.links, frames, strict=True)
        ]
        return jnp.concatenate([self.equations(ends, given), *own])

    @staticmethod
    def _apart(link: Link, ends: list[Any], given: list[Any]) -> Ambient:
        return vec.subtract(link.image(ends[link.source], given[link.source // 2]), link.state(ends[link.target]))

    def _costs(self, ends: list[Any], given: list[Any]) -> Array:
        """The costs of the ends."""
        bound = [problem.with_parameters(its) for problem, its in zip(self.problems, given, strict=True)]
        each = [
            cost(end)
            for one, pair in zip(bound, zip(ends[::2], ends[1::2], strict=True), strict=True)
            for cost, end in zip((one._start_cost, one.final_cost), pair, strict=True)
        ]
        return jnp.stack(each)
