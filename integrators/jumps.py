"""Jumps in the controls: values that change where no derivative does, as those of rounding and of whole numbers."""

from collections.abc import Callable, Iterator
from functools import partial
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np

from ..manifolds import InvalidInputError
from ..manifolds.numerics.ambient import Ambient
from ..manifolds.numerics.precision import working_precision
from .compilation import call_compiled
from .kinks import is_jump, rounded, zoomed
from .probing import PARTS

if TYPE_CHECKING:
    from .problem import OptimalControlProblem

SCALES = 10.0 ** np.arange(-4, 7, 2)  # sizes of controls between which a jump is looked for
WHOLE = "a whole number"
STEPS = {
    **{name: f"jnp.{name}" for name in ("round", "floor", "ceil", "sign", "argmax", "argmin")},
    **dict.fromkeys(("gt", "ge", "lt", "le", "eq", "ne"), "a comparison"),
    "rem": "the remainder of a division",
    "convert_element_type": WHOLE,
}


def require_no_jumps(problem: "OptimalControlProblem", q: Ambient, u: Ambient, covectors: Ambient) -> None:
    """Raise if a function of the problem jumps in the controls, along a coordinate of these from ``u``.

    Only functions that compute steps of the controls are looked at.
    """
    found = steps_in(lambda u: (problem.velocity(q, u), problem.cost_rate(q, u)), u)
    if not found:
        return
    m = problem.controls.dimension
    ways = (SCALES[:, None, None] * np.eye(m)).reshape(1, -1, m).astype(working_precision())
    state, control = (jax.tree.map(lambda leaf: np.asarray(leaf)[None], point) for point in (q, u))
    costate = jax.tree.map(lambda leaf: np.asarray(leaf)[:1], covectors)
    given = problem, state, costate, control, ways, np.ones((), ways.dtype)
    seen: Any = jax.tree.map(np.asarray, call_compiled(partial(zoomed, on_values=True), *given)[0])
    zoom, controls = seen
    for at in np.ndindex(zoom.size.shape):
        if is_jump(zoom.widths[at], zoom.changes[at], float(zoom.size[at])):
            place = jax.tree.map(lambda leaf, at=at: rounded(leaf[at], float(SCALES[at[1] // m])), controls)
            raise InvalidInputError(_words(PARTS[at[-1]], found, place))


def _words(name: str, found: list[str], control: Ambient) -> str:
    return (
        f"{name} jumps in the controls at u = {control}: it computes {' and '.join(found)} from them, and no derivative tells of "
        "the jump; expected a smooth function of u, because the conditions dH/du = 0 do not see a jump; try jnp.tanh(u / a) with "
        "a small a in place of a step, or, for controls from a finite set, a problem for each of them"
    )


def steps_in(function: Callable, *arguments: Any) -> list[str]:
    """Names of the steps that a function computes from its arguments, each once."""
    found = ((STEPS.get(equation.primitive.name), equation) for equation in dependent(function, *arguments))
    return list(dict.fromkeys(name for name, equation in found if name and (name != WHOLE or _is_cut(equation))))


def dependent(function: Callable, *arguments: Any) -> Iterator[Any]:
    """The equations of the program of a function that compute something from its arguments, inner programs included."""
    yield from _dependent(jax.make_jaxpr(function)(*arguments).jaxpr)


def _dependent(jaxpr: Any) -> Iterator[Any]:
    known = set(map(id, jaxpr.invars))
    for equation in jaxpr.eqns:
        if not any(id(v) in known for v in equation.invars):
            continue
        known.update(map(id, equation.outvars))
        yield equation
        for inner in jax.tree.leaves(list(equation.params.values()), is_leaf=lambda leaf: hasattr(leaf, "eqns")):
            if hasattr(inner, "eqns"):
                yield from _dependent(getattr(inner, "jaxpr", inner))


def _is_cut(equation: Any) -> bool:
    """Whether real numbers become whole ones."""
    before, after = (v.aval.dtype for v in (equation.invars[0], equation.outvars[0]))
    return jnp.issubdtype(before, jnp.inexact) and not jnp.issubdtype(after, jnp.inexact)
