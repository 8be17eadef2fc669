"""Functions that are evaluated once, at some points: on a tape, for which nothing is compiled, where one can be
written."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import jax
import numpy as np

from ..manifolds import Manifold
from ..manifolds.numerics import ambient as vec
from ..manifolds.numerics.ambient import Ambient
from ..reading import one_reading
from ..undisturbed import undisturbed
from .compilation import call_compiled

if TYPE_CHECKING:
    from ..tape import Tape

MOST_ENTRIES = 64  # of the arguments: a program of scalars grows with the size of arrays, what XLA compiles does not


def at_each(function: Callable[..., Any], points: Any, *arguments: Any) -> Any:
    """Values of ``function(point, *arguments)`` at each of ``points``, NumPy arrays with the points along the leading
    axis.

    ``function`` is a JAX function of arrays. It is computed on a tape, or compiled where that has no rule for what the
    function calls, or arrays are large.
    """
    return _evaluated(_tape(function, vec.taken(points, 0), *arguments), function, points, *arguments)


def violations_at(manifold: Manifold, points: Ambient) -> dict[str, np.ndarray]:
    """``manifold.violations`` of points, arrays with one leading axis; it is traced once in a reading."""
    points = jax.tree.map(lambda s, a: np.asarray(a, s.dtype), manifold.ambient, points)
    key = "violations", id(manifold)
    with one_reading() as reading:  # which keeps the manifold, so that no other object gets its number
        tape, _ = reading.once(key, lambda: (_tape(manifold.violations, vec.taken(points, 0)), manifold))
        return _evaluated(tape, manifold.violations, points)


def _evaluated(tape: "Tape | None", function: Callable[..., Any], points: Any, *arguments: Any) -> Any:
    if tape is None:
        return jax.tree.map(np.asarray, call_compiled(_each, function, points, arguments)[0])
    count = len(jax.tree.leaves(points)[0])
    fixed = jax.tree.map(lambda leaf: np.repeat(np.asarray(leaf)[..., None], count, axis=-1), arguments)
    values = tape(jax.tree.map(lambda leaf: np.moveaxis(np.asarray(leaf), 0, -1), points), *fixed)
    return jax.tree.map(lambda leaf: np.moveaxis(leaf, -1, 0), values)


@undisturbed  # the imports too
def _tape(function: Callable[..., Any], *examples: Any) -> "Tape | None":
    """The tape of a function; None where there is none, or it would be long."""
    from ..tape import NotTraceableError, Tape  # they load CasADi and Numba

    if sum(np.size(leaf) for leaf in jax.tree.leaves(examples)) > MOST_ENTRIES:
        return None
    try:
        return Tape.trace(function, *examples)
    except NotTraceableError:
        return None


def _each(function: Callable[..., Any], points: Any, arguments: Any) -> Any:
    return jax.vmap(lambda point: function(point, *arguments))(points)
