"""Steps whose stages lie in ``S_f``: the dynamics on the final constraint manifold, with the gauge that is free in
it."""

from typing import Any, NamedTuple, Self, final

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike

from ....manifolds import Euclidean, InvalidInputError, Manifold, NotOnManifoldError, Submanifold
from ....manifolds.numerics.ambient import Ambient
from ....manifolds.numerics.root import find_root
from ....retractions import CotangentLift
from ...initial_value.step import StepEquations, StepResult, restore
from ...problem.optimal_control_problem import OptimalControlProblem, is_same_problem
from ...problem_checks.requirements import require_same_manifold
from ...stages import HamiltonianStage
from ..integrability import Classification, FinalEquations
from .strategy import Gauge, NotApplicableError, SingularIntegrator

Pair = tuple[Ambient, Ambient]


class Memory(NamedTuple):
    """The memory of a step for the next step: the unknowns of its control, the control, and the time at its end."""

    unknowns: Array
    control: Ambient
    time: Array


@final
class FinalDynamics(eqx.Module):
    """``zdot = X_H(z, u)`` with the controls ``u`` that the equations of ``S_f`` determine on ``P_f``.

    What they leave free is ``gauge(t, q, p)``, an array of shape ``(gauge controls,)``; without it the control of least
    norm.
    """

    manifold: Manifold
    equations: FinalEquations
    gauge: Gauge | None

    @classmethod
    def of(cls, classification: Classification, gauge: Gauge | None) -> Self:
        """The dynamics of the first stratum. Raises ``NotApplicableError`` where the gauge has to be given."""
        controls, free = classification.problem.controls, classification.gauge_controls
        if gauge is None and free and not isinstance(controls, Euclidean):
            raise NotApplicableError(
                f"controls on {controls} have no norm to choose {free} of them by: give gauge(t, q, p)"
            )
        return cls(classification.manifold, classification.stratum.feedback, gauge)

    @property
    def problem(self) -> OptimalControlProblem:
        """The problem that was classified."""
        return self.equations.array.problem

    def on(self, system: OptimalControlProblem) -> Self:
        """The dynamics with the data of ``system``, which may be traced, unlike the data of the classified problem."""

        def problems(dynamics: Any) -> list[OptimalControlProblem]:
            final = dynamics.manifold if isinstance(self.manifold, Submanifold) else None
            holders = [dynamics, final, getattr(final, "piece", None)]
            return [holder.equations.array.problem for holder in holders if holder is not None]

        return eqx.tree_at(problems, self, [system] * len(problems(self)))

    def check(self, system: object, lift: CotangentLift, z: Pair) -> None:
        """Raise if ``system`` is another problem, or ``z`` is not on ``P_f``."""
        if not is_same_problem(system, self.problem):
            raise InvalidInputError("the integrator was made for another problem; classify the one to be integrated")
        require_same_manifold(self.problem, lift.discretization)
        verdict = self.manifold.contains(z)
        if not verdict:
            raise NotOnManifoldError(
                f"start is not on P_f: {verdict.reason}; classification.manifold.nearby((q, p)) is a point of P_f near "
                "it"
            )

    def begin(self) -> Memory:
        """The prediction for the first step: the control at the point of the stratum."""
        jet, pivots = self.equations.jet.reshape(-1), self.equations.pivots
        unknowns = jet[jnp.asarray(pivots.eliminated, int)]
        if self._minimal:
            unknowns = jnp.concatenate(
                [unknowns, jet[jnp.asarray(pivots.free)], jnp.zeros(len(pivots.solved), jet.dtype)]
            )
        return Memory(unknowns, self._steer(jet), jnp.zeros(()))

    def step(self, lift: CotangentLift, h: ArrayLike, q: Ambient, p: Ambient, previous: Memory) -> StepResult:
        """``(q, p; q', p') = R_d^{T*}(h X_H(z, u))`` for a ``z`` and a control ``u`` that satisfy the equations solved
        for it.

        These are equations of ``S_f`` where ``z`` is in ``P_f``.
        """
        middle = previous.time + lift.theta * h

        def stage(u: Ambient) -> HamiltonianStage:
            return HamiltonianStage(
                hamiltonian=lambda x, pi: self.problem.hamiltonian(x, pi, u), discretization=lift.discretization, step=h
            )

        last: Memory = jax.lax.stop_gradient(previous)
        begun = StepEquations.near(stage(last.control), q, p, None)
        size = begun.first.size
        x, _, pi = begun.unknowns(begun.first)
        frame = self._row_frame((x, pi), self._jet(middle, (x, pi), last.unknowns)) if self._minimal else None

        def equations(c: Array) -> tuple[StepEquations, Array, Array]:
            x, _, pi = begun.unknowns(c[:size])
            jet = self._jet(middle, (x, pi), c[size:])
            u = self._steer(jet)
            return StepEquations(stage(u), begun.chart), self._control_equations((x, pi), jet, c[size:], frame), u

        def residual(c: Array) -> Array:
            moving, determined, _ = equations(c)
            return jnp.concatenate([moving.residual(c[:size], q, p), determined])

        sizes = jnp.concatenate([begun.sizes, self._sizes])
        root, found = find_root(residual, jnp.concatenate([begun.first, last.unknowns]), sizes)
        moving, _, u = equations(root)
        q1, p1, _ = moving.end(root[:size])
        found = found & moving.begins(root[:size], q)
        return restore(self.problem.manifold, StepResult(q1, p1, Memory(root[size:], u, previous.time + h), found))

    @property
    def _minimal(self) -> bool:
        """Whether gauge controls are chosen by the norm of the control."""
        return self.gauge is None and bool(self.equations.pivots.free)

    def _steer(self, jet: Array) -> Ambient:
        return self.problem._steer(self.equations.center, jet[: self.problem.controls.dimension])

    def _jet(self, t: Array, z: Pair, unknowns: Array) -> Array:
        """The raveled control and its derivatives, the eliminated entries from the unknowns, the free entries from
        these or the gauge."""
        pivots, count = self.equations.pivots, len(self.equations.pivots.eliminated)
        jet = self.equations.jet.reshape(-1).at[jnp.asarray(pivots.eliminated, int)].set(unknowns[:count])
        if not pivots.free:
            return jet
        free = unknowns[count : count + len(pivots.free)] if self.gauge is None else jnp.ravel(self.gauge(t, *z))
        return jet.at[jnp.asarray(pivots.free)].set(free)

    def _row_frame(self, z: Pair, jet: Array) -> Array:
        """The combinations of the rows of the array that are solved for the control of least norm.

        Of rows that depend on each other, those that are solved at the point of the stratum may determine nothing
        elsewhere; the leading left singular vectors do.
        """
        pivots = self.equations.pivots
        varied, kept = (jnp.asarray(own, int) for own in (pivots.eliminated + pivots.free, pivots.kept))
        slope = jax.jacfwd(lambda y: self.equations.values(z, jet.at[varied].set(y)))(jet[varied]).at[kept].set(0.0)
        vectors = jnp.linalg.svd(slope, full_matrices=False)[0]
        return jax.lax.stop_gradient(vectors[:, : len(pivots.solved)].T)

    def _control_equations(self, z: Pair, jet: Array, unknowns: Array, frame: Array | None) -> Array:
        """The equations solved for the control; with a row frame also the conditions of least norm, whose multipliers
        are the last unknowns."""
        pivots = self.equations.pivots
        if frame is None:
            return self.equations.values(z, jet)[jnp.asarray(pivots.solved, int)]
        varied = jnp.asarray(pivots.eliminated + pivots.free)

        def lagrangian(y: Array) -> tuple[Array, Array]:
            moved = jet.at[varied].set(y)
            u, values = moved[: self.problem.controls.dimension], frame @ self.equations.values(z, moved)
            return u @ u / 2 + unknowns[varied.size :] @ values, values

        slope, values = jax.grad(lagrangian, has_aux=True)(jet[varied])
        return jnp.concatenate([values, slope])

    @property
    def _sizes(self) -> Array:
        """Typical sizes of the unknowns of the control."""
        pivots, columns = self.equations.pivots, self.equations.columns
        sizes = columns[jnp.asarray(pivots.eliminated, int)]
        if not self._minimal:
            return sizes
        energy = jnp.max(columns[: self.problem.controls.dimension]) ** 2
        return jnp.concatenate([sizes, columns[jnp.asarray(pivots.free)], jnp.full(len(pivots.solved), energy)])


class DynamicsIntegrator(SingularIntegrator):
    """A method for the problem of its ``dynamics``, from points of ``P_f``."""

    lift: CotangentLift
    dynamics: FinalDynamics

    def check(self, system: Any, q: Ambient, p: Ambient) -> None:
        self.dynamics.check(system, self.lift, (q, p))
