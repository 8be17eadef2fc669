"""The definition of the paper, where it composes into a flow: stages on the final constraint manifold."""

from typing import Any, ClassVar, NamedTuple, Self, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike

from ....compute.jit_cache import compile_function
from ....manifolds import Manifold, Submanifold
from ....manifolds.numerics import ambient as vec
from ....manifolds.numerics.ambient import Ambient
from ....manifolds.numerics.tolerances import tolerance
from ....retractions import CotangentLift
from ...initial_value.step import StepResult
from ...problem.optimal_control_problem import OptimalControlProblem
from ...reporting.text import plural
from ..integrability import Classification
from ..integrability.derivative_array import hamiltonian_field
from .final_dynamics import DynamicsIntegrator, FinalDynamics, Memory, Pair
from .strategy import Gauge, NotApplicableError

# Length of the steps of the test of composability, relative to the time in which states change by their size.
TEST_STEP = 0.5
TEST_STEPS = 10  # steps from each state, each from P_f: one alone may hide how they leave it
TIME_HALVINGS = 20  # of that length, where it is too long for Newton's method
# Power of the machine epsilon up to which departures from P_f are rounding: 8e-15, ten times what flat ones show.
COMPOSED = 0.9
# How much less at most steps of half the length depart, of order up to 6 in it, unless the longer were spurious.
SHRINKS = 64
# Powers of the machine epsilon up to which steps of any length may depart: of a P_f that is flat to rounding, 1e-11,
# and the first one, for a start may be beside P_f by what a check of it allows, 9e-8.
STAYED, STARTED = 0.7, 0.45
SMALLEST_ENTRY = 1e-8  # entries of a state or a costate this much smaller than the others are rounding on P_f


@final
class DirectIntegrator(DynamicsIntegrator):
    """``(1/h) (R_d^{T*})^-1 (z, z')`` lies in ``S_f`` over its base point.

    [Barbero-Linan, Martin de Diego, Presymplectic integrators for optimal control problems via retraction maps,
    Definition 1.] The relation is Lagrangian in ``P_{f,d}``. It is a map of ``P_f`` into itself only where the ends of
    its steps stay on ``P_f``, as on an affine ``P_f`` with a theta-method; ``suited`` measures that, and takes nothing
    but rounding for it. A step of which the end is not on ``P_f`` to rounding, as where that is curved elsewhere, is
    not solved; rounding is removed.
    """

    presymplectic: ClassVar[bool] = True
    meets_stages: ClassVar[bool] = True

    @classmethod
    def suited(cls, classification: Classification, lift: CotangentLift, gauge: Gauge | None) -> tuple[Self, str]:
        found = cls(lift=lift, dynamics=FinalDynamics.of(classification, gauge))
        trials = jax.tree.map(np.asarray, _trials(found, classification.problem, classification.stratum.states))
        count, composed, departed = len(trials.length), trials.solved, trials.departed > 1
        if np.any(departed):
            raise NotApplicableError(
                f"steps with stages in S_f leave P_f, its equations {np.max(trials.departure[departed]):.1e} at the "
                f"ends of some of length {np.max(trials.length[departed]):.1g}: they do not compose"
            )
        if not np.any(composed):
            raise NotApplicableError(
                f"no step with its stage in S_f was solved from any of {plural(count, 'point')} of P_f, whatever its "
                f"length (down to {np.min(trials.length):.0e})"
            )
        gap, solved = np.max(trials.departure[composed]), int(np.sum(composed))
        rest = (
            "" if solved == count else f"; from {count - solved} of {plural(count, 'point')} tried no step was solved"
        )
        return found, f"steps with stages in S_f stay on P_f (equations to {gap:.0e}{rest}), so they compose"

    def begin(self, system: OptimalControlProblem, q: Ambient, p: Ambient) -> Memory:
        return self.dynamics.begin()

    def unchecked_step(
        self, system: OptimalControlProblem, h: ArrayLike, q: Ambient, p: Ambient, previous: Memory
    ) -> StepResult:
        dynamics = self.dynamics.on(system)
        end, departure, unknowns, solved = _step(dynamics, self.lift, h, (q, p), previous)
        allowed = jnp.where(previous.time == 0, tolerance(departure, STARTED), tolerance(departure, STAYED))
        return StepResult(*end, unknowns, solved & (departure <= allowed))

    def hint(self, system: OptimalControlProblem, first: Pair, last: Pair) -> str:
        return (
            f"{super().hint(system, first, last)} Or a step of this length leaves P_f, as where that is curved: take a "
            "shorter one, or another strategy."
        )

    def control(self, unknowns: Memory) -> Ambient:
        return unknowns.control


class _Trial(NamedTuple):
    """Steps of one length from a point of ``P_f``, with the largest departure of the solved steps, and whether all were
    solved.

    ``departed``: at how many lengths, this one and those before, they left ``P_f`` (roots of steps that are too long
    may be spurious, so one says nothing).
    """

    length: Array
    departure: Array
    solved: Array
    departed: Array
    halvings: Array


@compile_function
def _trials(integrator: DirectIntegrator, problem: OptimalControlProblem, states: Any) -> _Trial:
    """Some steps from each of some points of ``P_f`` (leading axis), as long as they can be solved there."""
    states = jax.tree.map(jnp.asarray, states)
    longest = TEST_STEP * _time(integrator, problem, states)
    zero, allowed = jnp.zeros((), int), tolerance(longest, COMPOSED)

    def one(z: tuple[Ambient, Ambient]) -> _Trial:
        start = integrator.dynamics.manifold.restore(z)

        def shorter(trial: _Trial) -> _Trial:
            h = trial.length / 2
            departure, solved = _steps(integrator, problem, h, start)
            left = departure > jnp.where(trial.departed > 0, jnp.minimum(allowed, trial.departure / SHRINKS), allowed)
            return _Trial(h, departure, solved & ~left, jnp.where(left, trial.departed + 1, 0), trial.halvings + 1)

        def unknown(trial: _Trial) -> Array:
            return ~trial.solved & (trial.departed < 2) & (trial.halvings <= TIME_HALVINGS)

        return jax.lax.while_loop(
            unknown, shorter, _Trial(2 * longest, jnp.zeros_like(longest), jnp.array(False), zero, zero)
        )

    return jax.lax.map(one, states)


def _steps(
    integrator: DirectIntegrator, problem: OptimalControlProblem, h: Array, start: tuple[Ambient, Ambient]
) -> tuple[Array, Array]:
    """Largest departure at the ends of some steps, up to the first that is not solved, and whether all are solved."""
    dynamics = integrator.dynamics.on(problem)

    def step(state: tuple[Any, Array, Array, Array]) -> tuple[Any, Array, Array, Array]:
        (q, p, memory), departure, _, count = state
        end, gap, unknowns, solved = _step(dynamics, integrator.lift, h, (q, p), memory)
        return (*end, unknowns), jnp.where(solved, jnp.maximum(departure, gap), departure), solved, count + 1

    def going(state: tuple[Any, Array, Array, Array]) -> Array:
        return state[2] & (state[3] < TEST_STEPS)

    first = (*start, integrator.begin(problem, *start)), jnp.zeros_like(h), jnp.array(True), jnp.zeros((), int)
    _, departure, solved, _ = jax.lax.while_loop(going, step, first)
    return departure, solved


def _step(
    dynamics: FinalDynamics, lift: CotangentLift, h: ArrayLike, begin: Pair, previous: Memory
) -> tuple[Pair, Array, Memory, Array]:
    """The end of a step, moved to ``P_f``, its departure, the memory for the next step, and whether the step is
    solved."""
    new = dynamics.step(lift, h, *begin, previous)
    end = new.q, new.p
    departure = _departure(dynamics.manifold, begin, end)
    return dynamics.manifold.restore(end), departure, new.unknowns, new.converged & jnp.isfinite(departure)


def _departure(final: Manifold, begin: Pair, end: Pair) -> Array:
    """Equations of ``P_f`` at the end of a step, relative to one or to what moves of the size of a state change them
    by.

    To the rounding of that size, of its largest entry, steps are solved.
    """
    if not isinstance(final, Submanifold):
        return jnp.zeros(())
    values, normals = final.values(end)
    terms = [vec.coordinate_sizes(normals, z) for z in (begin, end)]
    return vec.largest(values / (1 + jnp.maximum(*terms)))


def _time(integrator: DirectIntegrator, problem: OptimalControlProblem, states: Any) -> Array:
    """The time in which entries of states and costates change by their typical size: of all points and entries the
    median.

    Entries are compared with their own rates, whatever their units; of a single point that is almost at rest the time
    would have no end.
    """
    dynamics = integrator.dynamics
    rates = jax.lax.map(lambda z: hamiltonian_field(problem, z, dynamics.equations.control(z)), states)
    times = [_times(*map(_entries, parts)) for parts in zip(states, rates, strict=True)]
    time = jnp.nanmedian(jnp.concatenate(times))
    return jnp.where(jnp.isfinite(time), time, 1.0)


def _entries(batch: Ambient) -> Array:
    return jnp.concatenate([jnp.abs(leaf).reshape(leaf.shape[0], -1) for leaf in jax.tree.leaves(batch)], axis=1)


def _times(sizes: Array, rates: Array) -> Array:
    """Typical sizes of entries over their rates, NaN where one is zero or rounding."""
    size, rate = jnp.nanmedian(sizes, axis=0), jnp.nanmedian(jnp.where(jnp.isfinite(rates), rates, jnp.nan), axis=0)
    moving = (rate > 0) & (size > SMALLEST_ENTRY * jnp.max(size, initial=0.0))
    return jnp.where(moving, size / jnp.where(moving, rate, 1.0), jnp.nan)
