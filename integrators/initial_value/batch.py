"""Many trajectories of one system at once."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike

from ...compute.at_points import violations_at
from ...compute.jit_cache import optimize_and_call
from ...manifolds import InvalidInputError, Manifold, NotOnManifoldError
from ...manifolds.numerics import ambient as vec
from ...manifolds.numerics.ambient import Ambient
from ...manifolds.numerics.precision import default_tolerance
from ...tracing import reads_once
from ..problem.user_functions import require_concrete
from .evaluator_choice import tape_steps
from .integrate import check_call, require_finite_step, run_on_tape, scan, without_jumps
from .integrator import Integrator
from .trajectory import Trajectory


@reads_once
def integrate_many(
    system: Any,
    integrator: Integrator,
    starts: tuple[Ambient, Ambient],
    step_sizes: ArrayLike,
    steps: int,
    save_every: int = 1,
    evaluator: str = "automatic",
    verbose: bool = False,
) -> Trajectory:
    """Integrate a system from many starts at once: ``integrate`` for each member of a leading axis.

    Parameters
    ----------
    system : callable or OptimalControlProblem
        As in ``integrate``.
    integrator : Integrator
        The method.
    starts : tuple of points and covectors
        ``(q0, p0)`` with a leading axis of length ``B``.
    step_sizes : float or array_like of shape (B,)
        The step, one for all or one each.
    steps, save_every : int
        The number of steps; one state in ``save_every`` is kept.
    evaluator : {"automatic", "tape", "xla"}
        The tape runs the members on all processors; XLA compiles one loop, which an interrupt does not stop.
    verbose : bool
        Whether to show the progress.

    Returns
    -------
    Trajectory
        The trajectory; every array, also ``result`` and ``failed_step``, has the leading axis ``B``.

    Raises
    ------
    InvalidInputError, NotOnManifoldError
        For other input, and under ``jit``, ``vmap`` and ``grad``: use ``jax.vmap`` of ``integrate`` there.

    Notes
    -----
    A member that stops, or passes a jump of the Hamiltonian, is marked and raises nothing.
    """
    check_call(integrator, steps, save_every, evaluator)
    require_concrete("integrate_many", system, integrator, starts, step_sizes)
    starts = _check_starts(integrator.manifold, starts)
    count = len(jax.tree.leaves(starts)[0])
    sizes = _check_sizes(step_sizes, count)
    integrator.check(system, *vec.taken(starts, 0))
    saves, every = int(steps) // int(save_every), int(save_every)
    found = tape_steps(system, integrator, starts, sizes, evaluator)
    if isinstance(found, str):
        batch = optimize_and_call(_scan, system, integrator, starts, jnp.asarray(sizes), saves, every, found)[0]
    else:
        batch = run_on_tape(found, integrator, sizes, saves, every, verbose)
    return without_jumps(system, integrator, batch, every)[0]


def _scan(
    system: Any,
    integrator: Integrator,
    starts: tuple[Ambient, Ambient],
    sizes: Array,
    saves: int,
    every: int,
    reason: str,
) -> Trajectory:
    return jax.vmap(lambda start, h: scan(system, integrator, start, h, saves, every, reason))(starts, sizes)


def _check_sizes(step_sizes: Any, count: int) -> np.ndarray:
    try:
        sizes = np.broadcast_to(np.asarray(step_sizes, float), (count,))
    except (TypeError, ValueError) as error:
        got = f"an array of shape {np.shape(step_sizes)}" if np.ndim(step_sizes) else repr(step_sizes)
        raise InvalidInputError(
            f"step_sizes must be one number or one for each of the {count} starts, got {got}"
        ) from error
    for size in sizes:
        require_finite_step("each of step_sizes", float(size))
    return np.ascontiguousarray(sizes)


def _check_starts(manifold: Manifold, starts: Any) -> tuple[Ambient, Ambient]:
    """Points and covectors as NumPy arrays with one leading axis; raises if they are not points and covectors."""
    if not (isinstance(starts, tuple | list) and len(starts) == 2):
        raise InvalidInputError(f"starts must be a pair (q0, p0) of points and covectors, got {starts!r}")
    counts = {np.shape(leaf)[:1] for leaf in jax.tree.leaves(starts)}
    if len(counts) != 1 or counts & {(), (0,)}:
        raise InvalidInputError(
            "starts must have arrays with one more axis, of one length, in front; got shapes "
            f"{jax.tree.map(np.shape, starts)}"
        )
    if not any(manifold.describe_shapes(part, "") for part in starts):
        raise InvalidInputError(
            "starts is a single one, expected one more axis in front of its arrays; try integrate, or "
            "np.asarray(q0)[None]"
        )
    found: list[Ambient] = []
    for part, role in zip(starts, ("a point", "a covector"), strict=True):
        wrong = manifold.describe_shapes(vec.taken(part, 0), role) or _wrong(manifold, part, role)
        if not wrong:
            with np.errstate(over="ignore"):  # in single precision numbers may become infinite
                found.append(jax.tree.map(lambda s, a: np.asarray(a, s.dtype), manifold.ambient, part))
            wrong = _wrong(manifold, found[-1], role)
        if wrong:
            raise NotOnManifoldError(f"starts: {wrong}")
    q0, p0 = found
    for words, values in violations_at(manifold, q0).items():
        worst = int(np.argmax(np.where(np.isnan(values), np.inf, values)))
        verdict = manifold.judge({words: values[worst]}, default_tolerance())
        if not verdict:
            raise NotOnManifoldError(f"start {worst}: {verdict.reason}")
    return q0, p0


def _wrong(manifold: Manifold, points: Ambient, role: str) -> str:
    """Words on what is wrong with arrays along a leading axis; empty if nothing is."""
    return manifold.describe_mismatch(jax.tree.map(lambda a: _worst(np.asarray(a)), points), role)


def _worst(a: np.ndarray) -> np.ndarray:
    """A member of an array's leading axis that is not finite if there is one, else the first."""
    if a.dtype.kind not in "fc":
        return a[0]
    finite = np.isfinite(a).reshape(len(a), -1).all(axis=1)
    return a[int(np.argmin(finite))]
