"""Quantities computed from a discrete extremal: Hamiltonians, momenta, what is conserved, and what leaves the
manifold."""

import math
from functools import partial
from typing import Any, NamedTuple, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ....compute.base import Evaluator, PointwiseFunction
from ....manifolds import Manifold, MatrixLieGroup
from ....manifolds.numerics import ambient as vec
from ....manifolds.numerics.ambient import Ambient
from ....manifolds.numerics.tolerances import EPS, ROUNDING
from ....manifolds.product import homogeneous_factors
from ...problem.optimal_control_problem import OptimalControlProblem
from ...problem.point_layout import PointLayout, parameter_layout
from ...problem_checks.control_probing import flat_directions
from ...stages.stage import positive

Stages = tuple[np.ndarray, np.ndarray, np.ndarray]  # states, controls and costates at the stages
SAMPLED_STAGES = 3  # stages at which symmetry and rounding are looked at


class Diagnostics(NamedTuple):
    """Derived quantities of a batch: along stages (B, S), along nodes (B, N + 1), and one number for each member."""

    hamiltonians: np.ndarray
    # Largest of the two parts <p, X> and F over the stages, no less than what is rounding in them.
    hamiltonian_size: np.ndarray
    momenta: dict[str, np.ndarray]
    violations: dict[str, np.ndarray]  # of the manifold's equations, largest over the nodes
    brackets: dict[str, np.ndarray]  # {J_i, H} of every momentum, relative to its parts: largest over the samples


class AlongStages(NamedTuple):
    """Values of a batch along its stages, (B, S)."""

    hamiltonians: np.ndarray
    sizes: np.ndarray  # the larger one of <p, X> and F
    normal: np.ndarray  # normal part of the dynamics, relative to 1 + its size


class AtNodes(NamedTuple):
    """Values of a batch along its nodes, (B, N + 1, ...): costates projected to the tangent spaces there, and what they
    give."""

    costates: np.ndarray
    momenta: dict[str, np.ndarray]
    body: dict[str, np.ndarray]
    spatial: dict[str, np.ndarray]
    violations: dict[str, np.ndarray]  # of the manifold's equations, largest over the nodes


@final
class Diagnosis:
    """Functions of a trajectory of a problem for its checks, traced once."""

    def __init__(self, problem: OptimalControlProblem, parameters: Any, evaluator: Evaluator) -> None:
        self.problem, self._evaluator = problem, evaluator
        self._parts: tuple[PointwiseFunction, ...] | None = None  # each traced where it is asked for
        self._limits: PointwiseFunction | None = None
        self.state, self.control = PointLayout.of(problem.manifold), PointLayout.of(problem.controls)
        self.parameter = parameter_layout(parameters)
        states, controls, given = self.state.size, self.control.size, self.parameter.size
        example = jax.tree.map(lambda s: np.zeros(s.shape, s.dtype), problem.manifold.ambient)
        factors = list(homogeneous_factors(problem.manifold, example))
        label = partial(problem.quantities.labelled, count=len(getattr(problem.manifold, "factors", ())))
        self._names = [label(name) for name, *_ in factors]
        self._groups = [label(name) for name, factor, _ in factors if isinstance(factor, MatrixLieGroup)]
        self._equations = [label(name) for name in jax.eval_shape(problem.manifold.violations, example)]
        self._stage = evaluator.values(self._at_stage, states, controls, states, given)
        self._node = evaluator.values(self._at_node, states, states)
        dimension = problem.manifold.dimension + problem.controls.dimension
        self._terms = evaluator.derivatives(self._terms_of, dimension, states, controls, states, given)

    def at_nodes(self, nodes: np.ndarray, costates: np.ndarray) -> AtNodes:
        """Values of states and ambient covectors at the nodes, (B, N + 1, E)."""
        projected, violations, *frames = self._node.at(2, nodes, costates)
        count = len(self._names)
        momenta, rest = dict(zip(self._names, frames[:count], strict=True)), frames[count:]
        body, spatial = (
            dict(zip(self._groups, rest[::2], strict=True)),
            dict(zip(self._groups, rest[1::2], strict=True)),
        )
        worst = dict(zip(self._equations, violations.max(axis=1).T[1:], strict=True))
        return AtNodes(projected, momenta, body, spatial, worst)

    def along(self, stages: Stages, parameters: np.ndarray) -> AlongStages:
        """Values of states, controls and costates at the stages, (B, S, ...)."""
        return AlongStages(*self._stage.at(2, *stages, parameters[:, None]))

    def of(
        self, nodes: AtNodes, along: AlongStages, stages: Stages, parameters: np.ndarray, held: np.ndarray | None = None
    ) -> Diagnostics:
        """Diagnostics from the values along nodes and stages.

        ``held``, shape (B,): whether inequalities hold the trajectory, whose symmetries are then also those of the
        inequalities.
        """
        rounding, brackets = self._at_samples(stages, parameters[:, None], held)
        size = np.maximum(along.sizes.max(axis=1), rounding)
        return Diagnostics(along.hamiltonians, size, nodes.momenta, nodes.violations, brackets)

    def is_invertible(self, stages: Stages, parameters: np.ndarray) -> bool:
        """Whether ``d2H/du2`` is invertible at the samples of the stages of one trajectory, as for a regular
        problem."""
        return bool(np.all(self.invertible(_samples(stages), parameters)))

    def invertible(self, at: tuple[np.ndarray, ...], parameters: np.ndarray) -> np.ndarray:
        """Whether ``d2H/du2`` is invertible, shape (B, S), at states, controls and costates of shape (B, S, ...)."""
        slopes, curvatures = self.in_controls(at, parameters)
        shape = curvatures.shape[:2]
        points = zip(*(part.reshape(math.prod(shape), *part.shape[2:]) for part in (slopes, curvatures)), strict=True)
        return np.array([not len(flat_directions(*one)) for one in points], bool).reshape(shape)

    def in_controls(self, at: tuple[np.ndarray, ...], parameters: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """First and second derivatives of ``<p, X>`` and ``F`` by the controls at such points, (B, S, 2, m) and (B, S,
        2, m, m)."""
        if self._parts is None:
            self._parts = tuple(self._by_controls(partial(self._part_of, k), self.state.size) for k in (0, 1))
        found = [part.at(2, *at, parameters[:, None]) for part in self._parts]
        curvatures, slopes = (np.stack([values[k] for values in found], axis=2) for k in (0, 1))
        return slopes, curvatures

    def of_limits(self, at: tuple[np.ndarray, ...], parameters: np.ndarray) -> np.ndarray:
        """Second derivatives of ``nu g`` by the controls, (B, S, m, m), at states, controls and multipliers."""
        if self._limits is None:
            self._limits = self._by_controls(self._limit_of, at[2].shape[2])
        return self._limits.at(2, *at, parameters[:, None])[0]

    def _by_controls(self, part: Any, covectors: int) -> PointwiseFunction:
        """Derivatives of a part of the Hamiltonian by the controls."""
        sizes = self.state.size, self.control.size, covectors, self.parameter.size
        return self._evaluator.derivatives(part, self.problem.controls.dimension, *sizes)

    def _part_of(self, k: int, d: Array, *given: Array) -> tuple[Array, Array]:
        """The power ``<p, X>`` or the cost rate at a control moved in its chart."""
        problem, q, u, p = self._problem_at(*given)
        return problem._parts(q, p, problem._steer(u, d))[k], jnp.zeros(0)

    def _limit_of(self, d: Array, q: Array, u: Array, pull: Array, parameters: Array) -> tuple[Array, Array]:
        """The inequalities times their multipliers at a control moved in its chart."""
        problem, point, control, _ = self._problem_at(q, u, q, parameters)
        return pull @ problem.inequalities(point, problem._steer(control, d)), jnp.zeros(0)

    def _at_samples(
        self, stages: Stages, given: np.ndarray, held: np.ndarray | None
    ) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """Size below which ``<p, X>`` and ``F`` are rounding of the terms that they are sums of; and the brackets.

        The terms of ``F`` show in its derivatives, by coordinates in units of their size or of 1, whichever is larger:
        where ``F = (q + u)^2 / 2`` is zero, the second ones are not.
        """
        curvature, slope, _, _, power, rate, sizes, *rates = self._terms.at(2, *_samples(stages), given)
        slopes = np.abs(slope) + (np.abs(curvature) @ sizes[..., None])[..., 0]
        parts = power + np.abs(rate) + (slopes * sizes).sum(axis=2)
        rounding = ROUNDING * EPS * parts.max(axis=1)
        count = len(self._names)
        largest = [values.max(axis=1) for values in rates]
        brackets, broken = largest[:count], largest[count:]
        if held is not None and broken:
            pairs = zip(brackets, broken, strict=True)
            brackets = [np.maximum(own, np.where(held[:, None], limit, 0.0)) for own, limit in pairs]
        return rounding, dict(zip(self._names, brackets, strict=True))

    def _problem_at(
        self, q: Array, u: Array, p: Array, parameters: Array
    ) -> tuple[OptimalControlProblem, Ambient, Ambient, Ambient]:
        bound = self.problem.with_parameters(self.parameter.point(parameters))
        return bound, self.state.point(q), self.control.point(u), self.state.point(p)

    def _at_stage(self, *given: Array) -> tuple[Array, Array, Array]:
        problem, q, u, p = self._problem_at(*given)
        velocity, rate = problem.velocity(q, u), problem.cost_rate(q, u)
        power, speed = vec.pairing(p, velocity), vec.size(velocity)
        normal = vec.size(vec.subtract(velocity, problem.manifold.projection(q, velocity)))
        return power - rate, jnp.maximum(jnp.abs(power), jnp.abs(rate)), normal / (1 + speed)

    def _at_node(self, q: Array, p: Array) -> tuple[Array, ...]:
        """The projected covector, violations of the manifold's equations, and momenta of every factor on which a group
        acts;

        then body and spatial covectors of the matrix groups among them.
        """
        manifold, momenta, covectors = self.problem.manifold, [], []
        point = self.state.point(q)
        tangent = manifold.projection(point, self.state.point(p))
        points = (homogeneous_factors(manifold, part) for part in (point, tangent))
        for (_, factor, x), (_, _, covector) in zip(*points, strict=True):
            momenta.append(factor.momentum(x, covector))
            if isinstance(factor, MatrixLieGroup):
                covectors += [factor.body(x, covector), factor.spatial(x, covector)]
        violations = jnp.stack([jnp.zeros(()), *manifold.violations(point).values()])
        return self.state.flat(tangent), violations, *momenta, *covectors

    def _terms_of(self, d: Array, *given: Array) -> tuple[Array, ...]:
        problem, q, u, p = self._problem_at(*given)
        (velocity, rate), pull = vec.pullback(lambda x: (problem.velocity(x, u), problem.cost_rate(x, u)), q)
        (force,) = pull((p, -jnp.ones_like(rate)))
        n, frame = problem.manifold.dimension, problem.manifold.basis(q)
        directions = problem.controls.basis(u)
        sizes = vec.coordinate_sizes(frame, q), vec.coordinate_sizes(directions, u)
        # By the ambient space, like the brackets: a chart would only add terms of its own.
        near = vec.add(q, vec.combine(frame, d[:n])), vec.add(u, vec.combine(directions, d[n:]))
        power = vec.pairing(*jax.tree.map(jnp.abs, (p, velocity)))
        sizes_of_terms = power, rate, jnp.maximum(jnp.concatenate(sizes), 1.0)
        brackets = _brackets(problem.manifold, q, p, velocity, force)
        return problem.cost_rate(*near), jnp.zeros(0), *sizes_of_terms, *brackets, *_broken_symmetries(problem, q, u, p)


def _brackets(manifold: Manifold, *at: Ambient) -> tuple[Array, ...]:
    """Poisson brackets of the momenta of every factor with the Hamiltonian, relative to the largest sum of their terms.

    ``{J_i, H} = <dH/dq, xi_i> - D_q J_i[X]``, at a point, a covector, ``X`` and ``dH/dq``. The brackets vanish where
    the Hamiltonian is invariant under the action: then the momentum is conserved.
    """
    out = []
    factors = (homogeneous_factors(manifold, part) for part in at)
    for (_, factor, q), (_, _, p), (_, _, velocity), (_, _, force) in zip(*factors, strict=True):
        generators = factor.generators(q)
        turned = vec.components(generators, force)
        moved = jax.jvp(lambda z, f=factor, c=p: f.momentum(z, c), (q,), (velocity,))[1]
        size = vec.components(*jax.tree.map(jnp.abs, (generators, force))) + jnp.abs(moved)
        out.append(jnp.abs(turned - moved) / positive(jnp.max(size)))
    return tuple(out)


def _broken_symmetries(problem: OptimalControlProblem, q: Ambient, u: Ambient, p: Ambient) -> tuple[Array, ...]:
    """The brackets of the momenta with the inequalities, of each momentum the largest; none without inequalities.

    They vanish where the inequalities are invariant under the action.
    """

    def values(x: Ambient) -> Array:
        return jnp.concatenate([problem.inequalities(x, u), problem.node_inequalities(x)])

    limits, pull = vec.pullback(values, q)
    if not limits.size:
        return ()
    rest = vec.scale(0.0, q)  # no velocity: inequalities have no derivatives by the covector
    brackets = jax.vmap(lambda weights: _brackets(problem.manifold, q, p, rest, pull(weights)[0]))
    return tuple(jnp.max(rates, axis=0) for rates in brackets(jnp.eye(limits.size)))


def _samples(stages: tuple[np.ndarray, ...]) -> tuple[np.ndarray, ...]:
    """Entries of arrays of the stages, (B, S, ...), at the first stage, the last one and some between."""
    last = stages[0].shape[1] - 1
    places = [k * last // (SAMPLED_STAGES - 1) for k in range(SAMPLED_STAGES)]
    return tuple([part.take(places, axis=1) for part in stages])
