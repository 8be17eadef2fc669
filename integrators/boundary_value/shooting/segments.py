"""Multiple shooting on the final manifold ``P_f`` of a singular problem."""

from typing import Any, ClassVar, NamedTuple, final

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ....manifolds import Manifold, Submanifold
from ....manifolds.numerics import ambient as vec
from ....manifolds.numerics.ambient import Ambient, Frame
from ....retractions import BundleRetraction
from ...problem.optimal_control_problem import OptimalControlProblem
from ...singular import SingularIntegrator

Pair = tuple[Ambient, Ambient]


@final
class StepwiseGauge(eqx.Module):
    """Gauge controls that are constant on every step: ``values`` of shape ``(steps, gauge controls)``.

    ``fraction``: where in a step the integrator asks for them. ``meaning``: what the reason for an integrator says of
    them.
    """

    meaning: ClassVar[str] = "gauge controls constant on every step, of least norm that meet the ends"

    values: Array
    step: Array
    fraction: float = eqx.field(static=True)

    def __call__(self, t: Array, q: Ambient, p: Ambient) -> Array:
        index = jnp.round(t / self.step - self.fraction).astype(int)
        return self.values[jnp.clip(index, 0, len(self.values) - 1)]


class Iterate(NamedTuple):
    """Unknowns: points of ``P_f`` at which the segments start, leading axis M, and gauge controls of their L steps, (M,
    L, g)."""

    points: Pair
    gauge: Float[Array, "M L g"]


class Nodes(NamedTuple):
    """The nodes after each step of a segment, and the controls of the steps."""

    z: Pair
    controls: Any


class Linearisation(NamedTuple):
    """The segments from an iterate, and their derivatives by its coordinates.

    ``nodes`` have the segments and their steps along the first two axes; ``end`` is ``z_N``, and ``end_moves`` the
    frame of its derivatives by the last segment. ``gaps``, shape (M - 1, d): the end of each segment minus the start of
    the next, in the basis of ``T P_f`` there; ``pushes``, shape (M - 1, d, d + L g), their derivatives by the segment
    that ends. ``distance``: largest gap in the ambient space, relative to 1 + size.
    """

    nodes: Nodes
    end: Pair
    end_moves: Frame
    gaps: Array
    pushes: Array
    distance: Array
    solved: Bool[Array, ""]


@final
class Shooting(eqx.Module):
    """``N`` steps of an integrator on ``P_f``, in segments of ``L`` steps; the last may be shorter."""

    problem: OptimalControlProblem
    integrator: SingularIntegrator
    final: Manifold
    step: Array
    steps: int = eqx.field(static=True)
    length: int = eqx.field(static=True)

    @property
    def segments(self) -> int:
        """Number of segments M."""
        return -(-self.steps // self.length)

    def place(self, iterate: Iterate, frames: Frame, d: Array) -> tuple[Iterate, Frame]:
        """The iterate moved by coordinates ``d``, shape ``(M, d + L g)``, and bases of ``T P_f`` at its points.

        ``frames`` are those at the points it comes from; points are moved to ``P_f`` if they are beside it.
        """
        retraction, dimension = BundleRetraction(self.integrator.lift.discretization.retraction), self.final.dimension

        def move(z: Pair, frame: Frame, c: Array) -> tuple[Pair, Frame]:
            z = retraction(z, vec.combine(frame, c))
            z = self.final.nearby(z) if isinstance(self.final, Submanifold) else z
            return z, self.final.basis(z)

        points, frames = jax.vmap(move)(iterate.points, frames, d[:, :dimension])
        return Iterate(points, iterate.gauge + d[:, dimension:].reshape(iterate.gauge.shape)), frames

    def segment(self, z: Pair, gauge: Array, first: Array) -> tuple[Pair, tuple[Nodes, Array]]:
        """The end of a segment from ``z``, its nodes, and whether all its steps were solved; steps after the last do
        nothing."""
        problem, integrator = self.problem, _with_gauge(self.integrator, gauge)

        def step(
            carry: tuple[Ambient, Ambient, Any, Array], index: Array
        ) -> tuple[tuple[Ambient, Ambient, Any, Array], Nodes]:
            q, p, memory, solved = carry
            new = integrator.step(problem, self.step, q, p, memory)
            kept = new.q, new.p, jax.lax.stop_gradient(new.unknowns), solved & new.converged
            carry = jax.tree.map(lambda a, b: jnp.where(index < self.steps, a, b), kept, carry)
            return carry, Nodes(carry[:2], integrator.control(carry[2]))

        begin = *z, jax.lax.stop_gradient(integrator.begin(problem, *z)), jnp.array(True)
        (q, p, _, solved), nodes = jax.lax.scan(step, begin, first + jnp.arange(self.length))
        return (q, p), (nodes, solved)

    def linearise(self, iterate: Iterate, frames: Frame) -> Linearisation:
        """The segments from an iterate, and their derivatives along the frames and by the gauge controls."""
        points, gauge = iterate
        firsts = self.length * jnp.arange(self.segments)
        ends, pushes, (nodes, solved) = jax.vmap(self._propagate)(points, gauge, frames, firsts)
        (before, moved), (after, bases) = (
            vec.entries(trees, s)
            for trees, s in (((ends, pushes), slice(None, -1)), ((points, frames), slice(1, None)))
        )
        gap = vec.subtract(before, after)
        end, end_moves = vec.entries((ends, pushes), -1)
        return Linearisation(
            nodes=nodes,
            end=end,
            end_moves=end_moves,
            gaps=jax.vmap(vec.components)(bases, gap),
            pushes=jax.vmap(lambda e, a: jax.vmap(lambda v: vec.components(e, v))(a).T)(bases, moved),
            distance=vec.size(jax.tree.map(lambda a, b: vec.size(a) / (1 + vec.size(b)), gap, after)),
            solved=jnp.all(solved),
        )

    def _propagate(self, z: Pair, gauge: Array, frame: Frame, first: Array) -> tuple[Pair, Frame, tuple[Nodes, Array]]:
        """The end of a segment, its derivatives along the frame and by the gauge, its nodes, and whether it was
        solved."""

        def along(a: Pair, b: Array) -> tuple[Pair, Pair, tuple[Nodes, Array]]:
            return jax.jvp(lambda z, gauge: self.segment(z, gauge, first), (z, gauge), (a, b), has_aux=True)

        units = jnp.eye(gauge.size).reshape(gauge.size, *gauge.shape)
        rest = jnp.zeros((self.final.dimension, *gauge.shape))
        states = jax.tree.map(lambda leaf: jnp.concatenate([leaf, jnp.zeros((gauge.size, *leaf.shape[1:]))]), frame)
        return jax.vmap(along, out_axes=(None, 0, None))(states, jnp.concatenate([rest, units]))

    def trajectory(self, iterate: Iterate, nodes: Nodes) -> Nodes:
        """All nodes ``z_0 ... z_N``, and the controls of the N steps, in one row."""
        z, controls = jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[2:])[: self.steps], nodes)
        return Nodes(jax.tree.map(lambda a, b: jnp.concatenate([a[:1], b]), iterate.points, z), controls)


def _with_gauge(integrator: SingularIntegrator, values: Array) -> SingularIntegrator:
    """The integrator with other values of its stepwise gauge, if it has one."""
    return jax.tree.map(
        lambda part: StepwiseGauge(values, part.step, part.fraction) if isinstance(part, StepwiseGauge) else part,
        integrator,
        is_leaf=lambda part: isinstance(part, StepwiseGauge),
    )
