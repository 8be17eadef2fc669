"""RATTLE on the final constraint manifold of first-order singular arcs."""

from functools import partial
from typing import Any, ClassVar, NamedTuple, Self, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike

from ....compute.jit_cache import compile_function
from ....manifolds import Euclidean, InvalidInputError, NotOnManifoldError
from ....manifolds.numerics import ambient as vec
from ....manifolds.numerics.ambient import Ambient
from ....manifolds.numerics.precision import default_tolerance
from ....manifolds.numerics.root import find_root
from ....manifolds.numerics.tolerances import HALF, tolerance
from ....retractions import CotangentLift
from ...initial_value.step import StepEquations, StepResult, restore
from ...problem.initial_controls import resting_control
from ...problem.optimal_control_problem import OptimalControlProblem
from ...problem.pontryagin import extremal_control
from ...problem_checks.requirements import require_same_manifold
from ...reporting.text import plural
from ...stages import ControlStage
from ...stages.stage import positive
from ..integrability import Classification
from .control_affine_splitting import (
    Brackets,
    ControlAffineSplitting,
    affine_tolerance,
    brackets,
    check_splitting,
    merge_controls,
    regular_places,
    relative_curvature,
)
from .hamiltonian_leaf_flow import Point, ambient_field, bracket_size, leaf_flow
from .strategy import Gauge, NotApplicableError, SingularIntegrator


class _Memory(NamedTuple):
    """Unknowns of the stage, and the singular controls of the last step."""

    stage: Any
    singular: Array


@final
class RattleIntegrator(SingularIntegrator):
    """A presymplectic integrator on ``P_f = {phi = 0, psi = 0}`` for controls that enter ``H`` affinely.

    With ``H = H_0 + s . phi`` and ``psi = {phi, H_0}``, one step from ``z`` in ``P_f`` moves along the leaf of ``{phi =
    0}`` through ``z``, takes a cotangent-lifted step of ``H_0`` that lands on ``phi = 0``, and moves along the leaf
    there to ``psi = 0``. Moves along leaves do not change the form pulled back to ``{phi = 0}``: the step preserves
    ``P_f`` and ``omega_f``, is symmetric if the lifted step is, and of its order. Needs ``{phi_a, phi_b} = 0`` and
    ``{phi_a, psi_b}`` invertible on ``P_f``. [McLachlan, Modin, Verdier, Wilkins, Geometric generalisations of SHAKE
    and RATTLE, 2014]
    """

    lift: CotangentLift
    singular: tuple[int, ...] = eqx.field(static=True)
    presymplectic: ClassVar[bool] = True

    @classmethod
    def suited(cls, classification: Classification, lift: CotangentLift, gauge: Gauge | None) -> tuple[Self, str]:
        problem, stratum = classification.problem, classification.stratum
        if not isinstance(problem.controls, Euclidean):
            raise NotApplicableError(f"the controls lie on {problem.controls}, in which H cannot be affine")
        states = [vec.entries(stratum.states, i) for i in range(stratum.count)]
        curvature = _finite(
            [_curvature(problem, z, stratum.u) for z in states], "second derivatives of H in the controls"
        )
        singular = tuple(int(i) for i in np.flatnonzero(np.max(curvature, axis=0) <= affine_tolerance()))
        if not singular:
            raise NotApplicableError("H has a second derivative in every control")
        split = ControlAffineSplitting(problem, singular)
        facts = _finite(
            [_facts(split, z, stratum.u) for z in states], f"brackets of the constraints of the controls {singular}"
        )
        obstacles = [fact.obstacle(singular) or fact.describe_violation() for fact in facts]
        # Of constant rank on the piece, so not to be refused for a point at which the arc ends.
        obstacles += [fact.degenerate() for fact in facts] if all(fact.degenerate() for fact in facts) else []
        if any(obstacles):
            raise NotApplicableError(next(filter(None, obstacles)))
        noun = "controls" if len(singular) > 1 else "control"
        reason = f"H is affine in the {noun} {singular}, and the arc is of first order"
        return cls(lift=lift, singular=singular), reason

    def check(self, system: OptimalControlProblem, q: Ambient, p: Ambient) -> None:
        super().check(system, q, p)
        check_splitting(system, self.singular)
        require_same_manifold(system, self.lift.discretization)
        facts = _facts(ControlAffineSplitting(system, self.singular), (q, p), resting_control(system.controls))
        if facts.describe_violation():
            raise NotOnManifoldError(f"start is not on the constraint manifold: {facts.describe_violation()}")
        obstacle = facts.obstacle(self.singular) or facts.degenerate()
        if obstacle:
            raise InvalidInputError(obstacle)

    def begin(self, system: OptimalControlProblem, q: Ambient, p: Ambient) -> _Memory:
        regular = ControlAffineSplitting(system, self.singular).regular_problem()
        return _Memory((q, extremal_control(regular, q, p)), jnp.zeros(len(self.singular)))

    def unchecked_step(
        self, system: OptimalControlProblem, h: ArrayLike, q: Ambient, p: Ambient, previous: _Memory
    ) -> StepResult:
        split = ControlAffineSplitting(system, self.singular)
        m = len(self.singular)
        stage = ControlStage(problem=split.regular_problem(), discretization=self.lift.discretization, step=h)
        flow = jax.jit(partial(leaf_flow, split.primary))  # traced once
        predicted = jax.lax.stop_gradient(previous.singular) * h / 2
        begin = flow((q, p), predicted)
        motion = ambient_field(lambda q, p: stage.problem.hamiltonian(q, p, previous.stage[1]), begin)
        # phi at the end, over h, is as sensitive to the covector as to divide its error by h: it is predicted to
        # O(h^2).
        equations = StepEquations.near(stage, begin[0], vec.add(begin[1], vec.scale(h, motion[1])), previous.stage)

        def residual(c: Array) -> Array:
            departed = flow(begin, c[:m])
            return jnp.concatenate([split.primary(*equations.end(c[m:])[:2]) / h, equations.residual(c[m:], *departed)])

        times = _leaf_times(split, (q, p))
        # The rounding of phi, over h, is a motion along the leaf, which the end does not depend on: its time is not
        # asked for.
        moved_by = jnp.maximum(jnp.abs(h) * vec.size(motion[0]) / positive(vec.size(q)), tolerance(times, HALF))
        sizes = jnp.concatenate([times / moved_by, equations.sizes])
        root, landed = find_root(residual, jnp.concatenate([jnp.zeros(m), equations.first]), sizes)
        moved, (q1, p1, unknowns) = predicted + root[:m], equations.end(root[m:])
        near = flow((q1, p1), moved)
        w = jax.lax.stop_gradient(unknowns[1])

        def rate(t: Array) -> Array:
            q, p = flow(near, t)
            return split.secondary(q, p, w)

        last, arrived = find_root(rate, jnp.zeros(m), times)
        q2, p2 = flow(near, last)
        begun = equations.begins(root[m:], flow(begin, root[:m])[0])
        memory = _Memory(unknowns, (2 * moved + last) / h)
        new = restore(self.manifold, StepResult(q2, p2, memory, landed & begun & arrived))
        # A move along a leaf too long for the accuracy of its flow, as by a control without bound, leaves Q.
        stayed = vec.size(vec.subtract(new.q, q2)) <= default_tolerance() * (1 + vec.size(new.q))
        return new._replace(converged=new.converged & stayed)

    def hint(self, system: OptimalControlProblem, first: Point, last: Point) -> str:
        split = ControlAffineSplitting(system, self.singular)
        rest = resting_control(system.controls)
        least = [np.linalg.svd(_facts(split, z, rest).across.values, compute_uv=False)[-1] for z in (first, last)]
        return (
            f"{super().hint(system, first, last)} Its smallest singular value is {least[0]:.3g} at first, "
            f"{least[1]:.3g} at last."
        )

    def control(self, unknowns: _Memory) -> Array:
        return merge_controls(unknowns.stage[1], unknowns.singular, self.singular)


def _leaf_times(split: ControlAffineSplitting, z: Point) -> Array:
    """Times in which moves along leaves change positions, or covectors where they change nothing else, by their
    size."""
    fields = jax.vmap(lambda a: ambient_field(lambda q, p: a @ split.primary(q, p), z))(jnp.eye(len(split.singular)))
    speeds = [jax.vmap(vec.size)(part) for part in fields]
    along, up = (
        positive(vec.size(part)) / jnp.where(speed > 0, speed, 1.0) for part, speed in zip(z, speeds, strict=True)
    )
    return jax.lax.stop_gradient(jnp.where(speeds[0] > 0, along, jnp.where(speeds[1] > 0, up, 1.0)))


class _Facts(NamedTuple):
    """Second derivatives of H in the singular controls, relative to H, constraints, ``{phi_a, phi_b}``, ``{phi_a,
    psi_b}``.

    Beside each of these the size of the terms that it is a sum of, by which zero is told from rounding.
    """

    curvature: Array
    constraints: Array
    sizes: Array
    among: Brackets
    across: Brackets

    def describe_violation(self) -> str:
        """The first constraint that does not vanish, in words; empty if all do."""
        rounding = default_tolerance()
        for name, values, sizes in zip(("phi = dH/du", "psi = {phi, H_0}"), self.constraints, self.sizes, strict=True):
            if not np.all(np.abs(values) <= rounding * (sizes + rounding)):
                return f"{name} is {values}, expected 0"
        return ""

    def obstacle(self, singular: tuple[int, ...]) -> str:
        """Why the method does not apply, in words; empty if it does."""
        curvature, rounding = np.max(self.curvature), default_tolerance()
        if not curvature <= affine_tolerance():
            return (
                f"Pontryagin's Hamiltonian is not affine in the controls {singular}: its second derivative in them "
                f"reaches {curvature:.3g} of its size, expected 0; name the controls without cost of their own"
            )
        if not np.all(np.abs(self.among.values) <= rounding * self.among.sizes):
            return f"the brackets of the primary constraints are {np.asarray(self.among.values).tolist()}, expected 0"
        return ""

    def degenerate(self) -> str:
        """Where ``{phi, psi}`` is singular that it is so, in words; empty where it is not."""
        units = np.sqrt(np.diag(self.across.sizes))
        units = np.where(units > 0, units, 1.0)
        if not np.linalg.svd(self.across.values / np.outer(units, units), compute_uv=False)[-1] > default_tolerance():
            return (
                f"the brackets {{phi, psi}} have the singular values "
                f"{np.linalg.svd(self.across.values, compute_uv=False)}, expected all positive: the singular arc is of "
                "higher order, or a control is gauge"
            )
        return ""


def _finite(found: list[Any], what: str) -> list[Any]:
    """The values at points where all is finite. Raises ``NotApplicableError`` if there are none."""
    finite = [one for one in found if all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(one))]
    if not finite:
        raise NotApplicableError(f"the {what} are finite at none of {plural(len(found), 'point')} of P_f")
    return finite


@compile_function
def _facts(split: ControlAffineSplitting, z: Point, u: Array) -> _Facts:
    """Facts at a point, with the extremal control near ``u``."""
    places = np.asarray(split.singular)
    w = u[regular_places(u.size, split.singular)]
    fields = split.fields(z, w)
    sizes = [jax.vmap(lambda field: bracket_size(field, z))(field) for field in fields]
    return _Facts(
        curvature=_curvature(split.problem, z, u)[places],
        constraints=jnp.stack([split.primary(*z), split.secondary(*z, w)]),
        sizes=jnp.stack(sizes),
        among=brackets(fields[0], fields[0]),
        across=brackets(*fields),
    )


@compile_function
def _curvature(problem: OptimalControlProblem, z: Point, u: Array) -> Array:
    """Largest second derivative of H by each control, relative to H."""
    return jnp.max(jnp.abs(relative_curvature(problem, z, u)), axis=1)
