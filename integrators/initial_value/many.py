"""Many trajectories of one system at once."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike

from ...manifolds import InvalidInputError, Manifold, NotOnManifoldError
from ...manifolds.numerics import ambient as vec
from ...manifolds.numerics.ambient import Ambient
from ...manifolds.numerics.precision import default_tolerance
from ...reading import reads_once
from ..compilation import call_optimized
from ..evaluation import violations_at
from ..functions import require_concrete
from .integrator import Integrator
from .step_evaluator import tape_steps
from .trajectory import Trajectory, check_call, require_finite_step, run_on_tape, scanned, without_jumps


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
    """Integrate ``system`` from many starts at once: ``integrate`` for each member of a leading axis.

    ``starts``: points and covectors with that axis, ``B`` long; ``step_sizes``: one number or ``B``. Every array of the
    trajectory has the leading axis ``B``, ``result`` and ``failed_step`` too: a trajectory that stops, or passes a jump
    of the Hamiltonian, is marked there, nothing is raised for it. On the tape, which runs the trajectories side by side
    on all processors; where it cannot run, XLA compiles one loop for this number of steps, which Ctrl-C does not stop,
    and whose progress is not known. ``verbose``: as in ``integrate``.

    Raises ``InvalidInputError`` or ``NotOnManifoldError`` for input that is not what is described here, and for calls
    under ``jit``, ``vmap`` and ``grad``: there take ``jax.vmap`` of ``integrate``. Ctrl-C as in ``integrate``.
    """
    check_call(integrator, steps, save_every, evaluator)
    require_concrete("integrate_many", system, integrator, starts, step_sizes)
    starts = _checked_starts(integrator.manifold, starts)
    count = len(jax.tree.leaves(starts)[0])
    sizes = _checked_sizes(step_sizes, count)
    integrator.check(system, *vec.taken(starts, 0))
    saves, every = int(steps) // int(save_every), int(save_every)
    found = tape_steps(system, integrator, starts, sizes, evaluator)
    if isinstance(found, str):
        batch = call_optimized(_scanned, system, integrator, starts, jnp.asarray(sizes), saves, every, found)[0]
    else:
        batch = run_on_tape(found, integrator, sizes, saves, every, verbose)
    return without_jumps(system, integrator, batch, every)[0]


def _scanned(
    system: Any,
    integrator: Integrator,
    starts: tuple[Ambient, Ambient],
    sizes: Array,
    saves: int,
    every: int,
    reason: str,
) -> Trajectory:
    return jax.vmap(lambda start, h: scanned(system, integrator, start, h, saves, every, reason))(starts, sizes)


def _checked_sizes(step_sizes: Any, count: int) -> np.ndarray:
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


def _checked_starts(manifold: Manifold, starts: Any) -> tuple[Ambient, Ambient]:
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
