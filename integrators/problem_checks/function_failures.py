"""The words on an error that a function of a problem raises."""

import re
from difflib import get_close_matches

import jax
import numpy as np

from ...errors import FAILURES, TRACEABLE
from ...manifolds import Manifold
from ...manifolds.numerics.ambient import Ambient
from ..problem.optimal_control_problem import OptimalControlProblem
from ..problem.user_functions import BoundFunction, failing_line

HINTS = {  # by parts of what an error says
    "overloaded function": "try jax.numpy: jnp.stack([...]) instead of ca.vertcat, u @ u instead of ca.sumsqr(u)",
    "with a sequence": "try jnp.stack([...]) of all entries, instead of np.zeros and an assignment",
    "item assignment": "try jnp.stack([...]) of all entries, or x = x.at[0].set(...)",
    "object has no attribute 'dist": "try the squared distance in the ambient space, jnp.sum((x - y) ** 2)",
    "unsupported operand": "try an array, jnp.array([...]), instead of a list or a tuple",
}


IN_JAX = {  # what to write in a line that JAX cannot trace, by what is in it
    r"\b(max|min)\(": r"jnp.\1imum instead of \1",
    r"\bmath\.(\w+)": r"jnp.\1 instead of math.\1",
    r"\bnp\.(\w+)": r"jnp.\1 instead of np.\1",
    r"\b(float|int)\(": r"the number without \1(...)",
    r"\bif\b": "jnp.where(condition, a, b) instead of if",
}


def failure_words(problem: OptimalControlProblem, error: Exception, q: Ambient, u: Ambient) -> str:
    """Words on an error that a function of the problem raises at ``(q, u)``: what it is given, and what to try."""
    shapes = [jax.tree.map(np.shape, a) for a in (q, u)]
    reason = next(iter(str(error).splitlines()), type(error).__name__).rstrip(".")
    functions = {name: function for name, function, _ in problem._functions()}
    given = next((own.value for own in functions.values() if isinstance(own, BoundFunction)), None)
    other = "try another number of controls, or index what is there"
    if given is not None:
        expected = jax.tree.map(np.shape, given)
        other = f"parameters have the shapes {expected}, try other ones, another number of controls, or index them"
    hint = next((words for part, words in HINTS.items() if part in reason), _near_names(error) or other)
    where = failing_line(error, functions)
    if isinstance(error, jax.errors.JAXTypeError):
        reason, hint = f"JAX cannot trace them ({type(error).__name__})", _traceable(where.source)
    elif not _has_velocity(problem, q, u) and _has_velocity(problem, u, q):
        hint = "dynamics accepts (u, q): its arguments are (q, u), in this order"
    place = f", in {where.place}" if where.place else ""
    quoted = f', in "{where.source}"' if where.source else ""
    return (
        f"the problem's functions fail at a point q of {problem.manifold}, shape {shapes[0]}, and a control u of "
        f"{problem.controls}, shape {shapes[1]}{place}: {reason}{quoted}; {hint}"
    )


def _near_names(error: Exception) -> str:
    """Advice on an attribute that a module or an object does not have; empty for arrays and for other errors."""
    if not isinstance(error, AttributeError) or isinstance(error.obj, jax.Array):
        return ""
    names = [name for name in dir(error.obj) if not name.startswith("_")]
    near = get_close_matches(error.name or "", names)
    if near:
        return f"did you mean {' or '.join(near)}?"
    return f"its attributes are {', '.join(names)}" if isinstance(error.obj, Manifold) else ""


def _traceable(source: str) -> str:
    """The advice for a line that JAX cannot trace."""
    for pattern, words in IN_JAX.items():
        found = re.search(pattern, source)
        if found:
            return "try " + found.expand(words)
    return TRACEABLE


def _has_velocity(problem: OptimalControlProblem, *arguments: Ambient) -> bool:
    try:
        jax.eval_shape(problem.velocity, *arguments)
    except FAILURES:
        return False
    return True
