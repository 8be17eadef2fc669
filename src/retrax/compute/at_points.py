"""Functions that are evaluated once, at some points: on a tape, for which nothing is compiled, where one can be
written."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np

from ..manifolds import Manifold, Verdict
from ..manifolds.numerics import ambient as vec
from ..manifolds.numerics.ambient import Ambient
from ..manifolds.numerics.precision import default_tolerance
from ..tracing import one_tracing
from ..undisturbed import undisturbed
from .jit_cache import compile_and_call

if TYPE_CHECKING:
    from ..tape import Tape

MOST_ENTRIES = 64  # of the arguments: a program of scalars grows with the size of arrays, what XLA compiles does not


def evaluate_at_each(function: Callable[..., Any], points: Any, *arguments: Any) -> Any:
    """Values of ``function(point, *arguments)`` at each of ``points``, NumPy arrays with the points along the leading
    axis.

    ``function`` is a JAX function of arrays. It is computed on a tape, or compiled where that has no rule for what the
    function calls, or arrays are large.
    """
    return _evaluate_tape(_tape(function, vec.taken(points, 0), *arguments), function, points, *arguments)


def violations_at(manifold: Manifold, points: Ambient) -> dict[str, np.ndarray]:
    """The violations ``manifold.violations`` of points with one leading axis, which the values have too.

    In one reading, the violations of a manifold, or of manifolds with the same data, are traced once.
    """
    leaves, structure = jax.tree.flatten(manifold)
    try:
        hash(structure)
    except TypeError:  # a static field that cannot be hashed
        structure = id(manifold)
    key = "violations", structure, *map(id, leaves)
    with one_tracing() as reading:  # which keeps what is in the key, so that no other objects get these numbers
        tape, *_ = reading.once(key, lambda: (_tape(manifold.violations, vec.taken(points, 0)), manifold, leaves))
        return _evaluate_tape(tape, manifold.violations, points)


def judge_point(manifold: Manifold, point: Ambient) -> Verdict:
    """Whether an array, or arrays, of the ambient shapes are a point of the manifold, to half of the digits."""
    points = jax.tree.map(lambda s, a: np.asarray(a, s.dtype)[None], manifold.ambient, point)
    return manifold.judge(vec.taken(violations_at(manifold, points), 0), default_tolerance())


def _evaluate_tape(tape: "Tape | None", function: Callable[..., Any], points: Any, *arguments: Any) -> Any:
    """Values of a function at each of some points, along the leading axis, by its tape if there is one."""
    count = len(jax.tree.leaves(points)[0])
    if tape is None:
        of = _evaluate_alone if count == 1 else _evaluate_each
        return jax.tree.map(np.asarray, compile_and_call(of, function, points, arguments)[0])
    fixed = jax.tree.map(lambda leaf: np.repeat(np.asarray(leaf)[..., None], count, axis=-1), arguments)
    values = tape(jax.tree.map(lambda leaf: np.moveaxis(np.asarray(leaf), 0, -1), points), *fixed)
    return jax.tree.map(lambda leaf: np.moveaxis(leaf, -1, 0), values)


@undisturbed  # the imports too
def _tape(function: Callable[..., Any], *examples: Any) -> "Tape | None":
    """The tape of a function; None where there is none, or it would be long."""
    from ..tape import NotTraceableError, Tape  # they load CasADi

    if sum(np.size(leaf) for leaf in jax.tree.leaves(examples)) > MOST_ENTRIES:
        return None
    try:
        return Tape.trace(function, *examples)
    except NotTraceableError:
        return None


def _evaluate_alone(function: Callable[..., Any], points: Any, arguments: Any) -> Any:
    """Where there is one point; ``vmap`` refuses some functions, as callbacks that do not say how they are mapped."""
    value = function(jax.tree.map(lambda leaf: leaf[0], points), *arguments)
    return jax.tree.map(lambda leaf: jnp.asarray(leaf)[None], value)


def _evaluate_each(function: Callable[..., Any], points: Any, arguments: Any) -> Any:
    return jax.vmap(lambda point: function(point, *arguments))(points)
