"""Requirements on a problem and a method: terms that are treated, one manifold, and a map that is a retraction."""

import dataclasses
from collections.abc import Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import ClosedJaxpr

from ...errors import FAILURES
from ...index_bounds import require_indices
from ...manifolds import InvalidInputError, Product, RetraxError
from ...manifolds.bundles import same_manifold
from ...manifolds.numerics import ambient as vec
from ...manifolds.numerics.ambient import Ambient
from ...retractions import CollocationMethod, DiscretizationMap, Retraction
from ...tracing import trace_program
from ..problem.optimal_control_problem import OptimalControlProblem
from ..reporting.text import brief
from .control_use import warn_of_broadcast
from .function_failures import failure_words

HELD = "held controls"  # its dynamics are those of one sample
RETRACTED = 1e-4  # relative: less is rounding of a retraction by iterations or in single precision


def require_treated(problem: OptimalControlProblem, what: str, *treated: str) -> None:
    """Raise if the problem has bounds, constraints, an initial cost or a time that ``what`` does not treat."""
    limits, boundary = problem._limits, problem._boundary
    has = {
        "control bounds": any(limits.bounded.values()),
        "constraints": bool(limits.functions),
        "node constraints": bool(limits.node_functions),
        "an initial cost": problem.initial_cost is not None,
        "a node cost": problem.node_cost is not None,
        "an explicit time": problem.time_dependent,
        "boundary constraints": bool(boundary.functions),
        "periodic ends": boundary.turn is not None,
        HELD: problem.sampling is not None,
    }
    left = [words for words, there in has.items() if there and words not in treated]
    if left:
        raise InvalidInputError(
            f"the problem has {' and '.join(left)}, which {what} does not treat; expected a problem without; try "
            "one that has none"
        )


def require_values(problem: OptimalControlProblem) -> ClosedJaxpr:
    """The program of all functions of a problem, of the index of a node, a point and a control.

    Raises if a function cannot be called, reads entries that its arguments do not have, or returns another kind.
    """
    spaces = problem.manifold, problem.controls
    q, u = (jax.tree.map(lambda s: np.zeros(s.shape, s.dtype), space.ambient) for space in spaces)
    try:
        program = trace_program(problem._values, np.zeros((), int), q, u)
    except RetraxError:
        raise
    except FAILURES as error:
        raise InvalidInputError(failure_words(problem, error, q, u)) from error
    require_indices(program, "a function of the problem")
    warn_of_broadcast(program)
    return program


def leaving_words(problem: OptimalControlProblem, q: Ambient, u: Ambient, posed: OptimalControlProblem) -> str:
    """The manifold whose tangent space the dynamics leaves at ``(q, u)``.

    Of a product this is the factor with the largest normal part, by its label in the problem as its user posed it.
    """
    manifold, velocity, label = problem.manifold, problem.velocity(q, u), ""
    while isinstance(manifold, Product):
        normal = vec.subtract(velocity, manifold.projection(q, velocity))
        worst = int(np.argmax([vec.size(part) for part in normal]))
        if same_manifold(manifold, posed.manifold):
            label = f"{posed.quantities.factors(len(manifold.factors))[worst]}, "
        manifold, q, velocity = manifold.factors[worst], q[worst], velocity[worst]
    return f"{label}{manifold}"


def require_same_manifold(problem: OptimalControlProblem, method: DiscretizationMap | CollocationMethod) -> None:
    """Raise if a discretization map or a collocation method acts on another manifold than the problem."""
    if not same_manifold(method.manifold, problem.manifold):
        came, expected = method.manifold, problem.manifold
        raise InvalidInputError(f"the method acts on {came}, the problem on {expected}; use one manifold")


def require_retraction(retraction: Retraction, x: Ambient) -> None:
    """Raise unless ``R(x, 0) = x`` and ``D_v R(x, 0) = Id`` at a point, where a class of a user is in the retraction.

    With another derivative a method solves another problem, and nothing in its equations shows that.
    """
    if all(type(part).__module__.startswith("retrax.") for part in _parts(retraction)):
        return
    frame = retraction.manifold.basis(x)
    zero = jnp.zeros(retraction.manifold.dimension)
    y, push = jax.linearize(lambda c: retraction(x, vec.combine(frame, c)), zero)
    derivative = np.asarray(jax.vmap(lambda a: vec.components(frame, push(a)))(jnp.eye(zero.size)))
    apart = float(vec.size(vec.subtract(y, x)) / (1 + vec.size(x)))
    wrong = float(np.max(np.abs(derivative - np.eye(zero.size)), initial=0.0))
    if not (apart <= RETRACTED and wrong <= RETRACTED):
        what = f"R(x, 0) is {apart:.3g} away from x" if not apart <= RETRACTED else f"D_v R(x, 0) - Id is {wrong:.3g}"
        raise InvalidInputError(
            f"{brief(retraction)} is no retraction: at x = {brief(x)} {what}, expected 0; try "
            "retrax.testing.check_retraction(R), which says what is wrong"
        )


def _parts(retraction: Any) -> Iterator[Retraction]:
    """The retraction, and the retractions that it is made of."""
    if isinstance(retraction, Retraction):
        yield retraction
        for field in dataclasses.fields(retraction):  # pyright: ignore[reportArgumentType]  # a module is a dataclass
            yield from _parts(getattr(retraction, field.name, None))
    elif isinstance(retraction, tuple | list):
        for part in retraction:
            yield from _parts(part)
