"""Integration over many steps."""

from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ...compute.at_points import judge_point
from ...compute.automatic import check_evaluator
from ...compute.jit_cache import compile_function
from ...manifolds import ConvergenceError, InvalidInputError, Manifold, NotOnManifoldError, Verdict
from ...manifolds.numerics import ambient as vec
from ...manifolds.numerics.ambient import Ambient, is_count, is_finite_number, is_jitting, is_traced, is_transformed
from ...manifolds.numerics.precision import working_precision
from ...tracing import reads_once
from ..problem_checks.smoothness.hamiltonian_jumps import Energy, PassedJump, Segments
from ..reporting.result_sentences import Result, warn_about_precision
from .evaluator_choice import tape_steps
from .integrator import Integrator
from .interruptible_loop import run
from .trajectory import Remark, Trajectory
from .undefined_hamiltonian import not_finite_words
from .xla_steps import Carry, Nodes, XlaSteps, advance, begin, node

if TYPE_CHECKING:
    from .tape_steps import TapeSteps


_WHOLE = "JAX transforms the call, or jit is disabled"


@reads_once
def integrate(
    system: Any,
    integrator: Integrator,
    start: tuple[Ambient, Ambient],
    step_size: float | Array,
    steps: int,
    save_every: int = 1,
    throw: bool = True,
    evaluator: str = "automatic",
    verbose: bool = False,
) -> Trajectory:
    """Integrate a system from one start over steps of one size.

    Parameters
    ----------
    system : callable or OptimalControlProblem
        A Hamiltonian ``H(q, p)`` for a ``SymplecticIntegrator``; a problem for a ``PresymplecticIntegrator``.
    integrator : Integrator
        The method.
    start : tuple of point and covector
        ``(q0, p0)``. ``p0`` is an ambient array, used by its tangent projection.
    step_size : float
        The step ``h`` in the unit of time; negative for backward in time.
    steps, save_every : int
        The number of steps; one state in ``save_every`` is kept.
    throw : bool
        Whether to raise ``ConvergenceError``; otherwise read ``result`` and ``failed_step``.
    evaluator : {"automatic", "tape", "xla"}
        The evaluator of the steps; by default the tape if the functions have a scalar form.
    verbose : bool
        Whether to show the progress.

    Returns
    -------
    Trajectory
        The states at the nodes.

    Raises
    ------
    InvalidInputError, NotOnManifoldError
        For other input, and if the Hamiltonian is not finite at the start.
    ConvergenceError
        If a step cannot be solved, or the Hamiltonian jumps between two nodes.

    Notes
    -----
    Under ``jit``, ``vmap`` and ``grad`` nothing is checked: read ``result`` and ``failed_step``. Otherwise each call
    traces the functions anew. An interrupt is a ``KeyboardInterrupt`` whose argument is the trajectory until then.

    Examples
    --------
    >>> energy = lambda q, p: (p @ p + q @ q) / 2
    >>> method = SymplecticIntegrator(Gauss(2, Exponential(Euclidean(1))))
    >>> float(integrate(energy, method, (np.ones(1), np.zeros(1)), 0.1, 10).q[-1, 0].round(4))
    0.5403
    """
    check_call(integrator, steps, save_every, evaluator)
    if not is_traced(step_size):
        require_finite_step("step_size", step_size)
    q0, p0 = _check_start(integrator.manifold, start)
    count, every = int(steps) // int(save_every), int(save_every)
    # As an array of its kind first: for a number of Python XLA would compile the conversion.
    size = step_size if is_traced(step_size) else np.asarray(step_size, working_precision())
    arguments = system, integrator, (q0, p0), jnp.asarray(size, float), count, every
    transformed = is_transformed(arguments)
    if not transformed:
        integrator.check(system, q0, p0)
    whole = transformed or jax.config.jax_disable_jit  # pyright: ignore[reportAttributeAccessIssue]  # made at run time
    trajectory = scan(*arguments, _WHOLE) if whole else _in_pieces(*arguments, evaluator, verbose)
    found = ""
    if not transformed:
        trajectory, found = _check_jumps(system, integrator, trajectory, every)
    if throw and not is_traced(trajectory) and (failed := int(trajectory.failed_step)) >= 0:
        first, last = (vec.taken((trajectory.q, trajectory.p), i) for i in (0, -1))
        reason = found or f"{Result[trajectory.result]}{integrator.hint(system, first, last)}"
        raise ConvergenceError(f"step {failed}, from t = {failed * float(step_size):.6g}: {reason}")
    return trajectory


def _check_jumps(system: Any, integrator: Integrator, trajectory: Trajectory, every: int) -> tuple[Trajectory, str]:
    """The trajectory, with another result if the trajectory passes a jump, and words on the failure.

    The words are on a jump, or on a Hamiltonian that is not finite where a step was not solved. Raises if that is the
    start.
    """
    batch, found = without_jumps(system, integrator, vec.taken(trajectory, None), every)
    if found:
        return jax.tree.map(jnp.asarray, vec.taken(batch, 0)), found[0].words()
    failed = int(trajectory.failed_step)
    if failed < 0:
        return trajectory, ""
    nodes = trajectory.q, trajectory.p
    at_start, later = not_finite_words(system, integrator, nodes, trajectory.controls, failed)
    if at_start:
        raise InvalidInputError(at_start)
    return trajectory, later


def without_jumps(
    system: Any, integrator: Integrator, batch: Trajectory, every: int
) -> tuple[Trajectory, dict[int, PassedJump]]:
    """Trajectories along a leading axis, with another result where one passes a jump of the Hamiltonian; and these
    jumps."""
    energy, axes = Energy(integrator.energy, system, integrator.retraction), integrator.control_times.ndim
    controls = vec.taken(batch.controls, np.s_[:, :, *axes * (0,)])
    segments, count = Segments.between((batch.q, batch.p), controls), batch.times.shape[1] - 1
    found, solved = dict[int, PassedJump](), np.broadcast_to(batch.failed_step < 0, len(batch.times))
    for jump in energy.find_jumps(segments, every > 1):
        if solved[jump.segment // count]:
            found.setdefault(jump.segment // count, jump)
    if not found:
        return batch, found
    steps = np.full(len(batch.times), -1)
    steps[[*found]] = [every * (jump.segment % count) for jump in found.values()]
    result = jax.vmap(lambda step, old: Result.where(step < 0, old, Result.jump))(steps, batch.result)
    failed = jnp.where(steps < 0, batch.failed_step, steps)
    return eqx.tree_at(lambda t: (t.result, t.failed_step), batch, (result, failed)), found


def _check_start(manifold: Manifold, start: Any) -> tuple[Ambient, Ambient]:
    """``(q0, p0)`` as arrays; raises if they are no point and covector of the manifold."""
    if not (isinstance(start, tuple | list) and len(start) == 2):
        raise InvalidInputError(f"start must be a pair (q0, p0) of a point and a covector, got {start!r}")
    wrong = manifold.describe_mismatch(start[0], "a point") or manifold.describe_mismatch(start[1], "a covector")
    if wrong:
        raise NotOnManifoldError(f"start: {wrong}")
    q0, p0 = (jax.tree.map(lambda s, a: jnp.asarray(a, s.dtype), manifold.ambient, part) for part in start)
    if not (is_traced(manifold, q0, p0) or is_jitting()):
        # Once more: in single precision numbers may have become infinite.
        wrong = manifold.describe_mismatch(q0, "a point") or manifold.describe_mismatch(p0, "a covector")
        verdict = Verdict(False, wrong) if wrong else judge_point(manifold, q0)
        if not verdict:
            raise NotOnManifoldError(f"start: {verdict.reason}")
    return q0, p0


def check_call(integrator: Any, steps: Any, save_every: Any, evaluator: Any) -> None:
    """Raise for arguments of the wrong kind, and warn once if numbers are in single precision."""
    if not isinstance(integrator, Integrator):
        raise InvalidInputError(
            f"integrate takes an integrator as its second argument, got {integrator!r}; try "
            "SymplecticIntegrator(Gauss(2, retraction)), SymplecticIntegrator(CotangentLift(discretization)), or the "
            "first of what singular_integrator returns"
        )
    check_evaluator(evaluator)
    warn_about_precision()
    for name, count in (("steps", steps), ("save_every", save_every)):
        if not is_count(count):
            raise InvalidInputError(f"{name} must be a whole number of at least 1, got {count!r}")
    if steps % save_every:
        raise InvalidInputError(f"steps must be a multiple of save_every, got {steps} and {save_every}")


def require_finite_step(name: str, size: Any) -> None:
    """Raise unless the size of a step is a finite number other than 0."""
    if not (is_finite_number(size) and size != 0):
        raise InvalidInputError(f"{name} must be a finite number other than 0, got {size!r}")


@compile_function
def scan(
    system: Any,
    integrator: Integrator,
    start: tuple[Ambient, Ambient],
    step_size: Array,
    saves: int,
    every: int,
    reason: str,
) -> Trajectory:
    """The trajectory as one loop of fixed length, which can be differentiated, batched and compiled into something
    larger."""

    def step(carry: Carry, index: Array) -> tuple[Carry, None]:
        return advance(system, integrator, step_size, carry, index), None

    def block(carry: Carry, first: Array) -> tuple[Carry, Nodes]:
        carry, _ = jax.lax.scan(step, carry, first + jnp.arange(every))
        return carry, node(integrator, carry)

    first = begin(system, integrator, start)
    last, (q, p, controls) = jax.lax.scan(block, first, every * jnp.arange(saves))
    q, p = jax.tree.map(lambda a, b: jnp.concatenate([a[None], b]), (first.q, first.p), (q, p))
    times, stage_times = _times(integrator, step_size, every, jnp.arange(saves + 1))
    result = Result.where(last.failed_step < 0, Result.successful, Result.step_not_solved)
    return Trajectory(times, q, p, controls, stage_times, result, last.failed_step, Remark(f"XLA: {reason}"))


def _in_pieces(
    system: Any,
    integrator: Integrator,
    start: tuple[Ambient, Ambient],
    step_size: Array,
    saves: int,
    every: int,
    evaluator: str,
    verbose: bool,
) -> Trajectory:
    """The trajectory by ``run``. Nothing is compiled for the number of its nodes, so NumPy computes the times."""
    starts, step_sizes = jax.tree.map(lambda a: np.array(a)[None], (start, step_size))
    found = tape_steps(system, integrator, starts, step_sizes, evaluator)
    if not isinstance(found, str):
        return run_on_tape(found, integrator, step_sizes[0], saves, every, verbose)
    steps = XlaSteps(system, integrator, start, step_size, found)
    nodes, failed, interrupt = run(steps, saves, every, verbose)
    nodes = nodes._replace(controls=vec.taken(nodes.controls, np.s_[1:]))
    return _record(integrator, np.asarray(step_size), every, nodes, failed, interrupt, steps.evaluator)


def run_on_tape(
    steps: "TapeSteps", integrator: Integrator, step_size: np.ndarray, saves: int, every: int, verbose: bool
) -> Trajectory:
    """The trajectory, or the trajectories of a leading axis if ``step_size`` has one."""
    kept, failed, interrupt = run(steps, saves, every, verbose)
    nodes, failed = steps.nodes(kept), np.broadcast_to(failed, kept.shape[-1:])
    if not step_size.ndim:
        nodes, failed = vec.taken((nodes, failed), 0)
    return _record(integrator, step_size, every, nodes, failed, interrupt, steps.evaluator)


def _record(
    integrator: Integrator,
    step_size: np.ndarray,
    every: int,
    nodes: Nodes,
    failed: np.ndarray,
    interrupt: KeyboardInterrupt | None,
    evaluator: str,
) -> Trajectory:
    """The record of what was reached; raises the interrupt with it if there was one."""
    count = jax.tree.leaves(nodes.q)[0].shape[step_size.ndim]
    times = _times(integrator, step_size, every, np.arange(count))
    unfailed = Result.interrupted if interrupt else Result.successful
    if step_size.ndim:
        result = jax.vmap(lambda solved: Result.where(solved, unfailed, Result.step_not_solved))(failed < 0)
    else:
        result = unfailed if failed < 0 else Result.step_not_solved
    # jnp.asarray would compile something for each shape.
    record = nodes, times, result, np.asarray(failed, int)
    (q, p, controls), (at_nodes, at_stages), result, stopped = jax.device_put(record)
    trajectory = Trajectory(at_nodes, q, p, controls, at_stages, result, stopped, Remark(evaluator))
    if interrupt:
        # Not an exception of our own: only this very class ends a process, and the shell script around it, as Ctrl-C
        # does.
        interrupt.args = (trajectory,)
        raise interrupt
    return trajectory


def _times(integrator: Integrator, step_size: Any, every: int, nodes: Any) -> tuple[Any, Any]:
    """Times of the nodes with these numbers and of the stages of the step before each, in NumPy or JAX as they are
    given."""
    times = (step_size * every)[..., None] * nodes.astype(step_size.dtype)
    before_end = 1 - integrator.control_times.astype(step_size.dtype)
    axes = (1,) * before_end.ndim
    lengths = before_end * step_size.reshape(*step_size.shape, 1, *axes)
    return times, times[..., 1:].reshape(*times.shape[:-1], -1, *axes) - lengths
