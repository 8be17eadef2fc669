"""The choice of the evaluator: tapes of scalar instructions, or XLA for functions that cannot be traced."""

import math
from collections.abc import Callable, Sequence
from typing import Any, final

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import ClosedJaxpr

from ..manifolds import InvalidInputError
from ..manifolds.numerics.precision import working_precision
from ..tracing import trace_program
from .base import Arrays, Evaluator, Function, PointwiseFunction
from .jit_cache import call_in_chunks, of_rows
from .tape_evaluator import ALL_TRACED, MOST_OPERATIONS, LargeTapeError, TapeEvaluator


@final
class XlaEvaluator(Evaluator):
    """Compiles functions by XLA, in the working precision."""

    def __init__(self, reason: str) -> None:
        self._reason = reason

    @property
    def name(self) -> str:
        """``"xla"``."""
        return "xla"

    @property
    def reason(self) -> str:
        """Why XLA compiles the functions."""
        return self._reason

    def _make(self, function: Function, sizes: Sequence[int], first: int | None) -> PointwiseFunction:
        def at_point(*arguments: Any) -> Any:
            if first is None:
                return function(*arguments)
            zero = jnp.zeros(first)
            slope = jax.grad(lambda d: function(d, *arguments)[0])
            scalar_slope, push = jax.linearize(lambda d: (slope(d), function(d, *arguments)[1]), zero)
            curvature, jacobians = jax.vmap(push, out_axes=-1)(jnp.eye(first))
            return curvature, scalar_slope[0], *jax.tree.leaves((jacobians, function(zero, *arguments)[1:]))

        return _XlaFunction(trace_program(at_point, *(np.zeros(size) for size in sizes)))


@final
class _XlaFunction(PointwiseFunction):
    """A traced function, compiled for each number of points."""

    def __init__(self, program: ClosedJaxpr) -> None:
        self._function = of_rows(program)
        arguments, values = ([math.prod(a.shape) for a in found] for found in (program.in_avals, program.out_avals))
        self.sizes = arguments, values  # numbers of each argument, and of each value

    @property
    def precision(self) -> np.dtype[Any]:
        return np.dtype(working_precision())

    def at(self, axes: int, *arguments: np.ndarray) -> Arrays:
        leading, filled = _fill(axes, arguments)
        return tuple(v.reshape(*leading, *v.shape[1:]) for v in self._rows(*filled))

    def of_any(self, axes: int, *arguments: np.ndarray) -> Arrays:
        leading, filled = _fill(axes, arguments)  # one program serves all numbers of them
        return tuple(v.reshape(*leading, *v.shape[1:]) for v in call_in_chunks(self._rows, *filled))

    def _rows(self, *filled: np.ndarray) -> Arrays:
        """The values at points in rows."""
        # Copies: the arrays of XLA are read-only, and the assembly adds to them.
        return tuple(np.array(v, dtype=float, order="C") for v in self._function(*filled))


def _fill(axes: int, arguments: Sequence[np.ndarray]) -> tuple[tuple[int, ...], list[np.ndarray]]:
    """The leading axes of arrays, and the arrays with these in one, in the working precision."""
    leading = np.broadcast_shapes(*(a.shape[:axes] for a in arguments))
    wide = ((np.broadcast_to(a, (*leading, a.shape[-1])), a.shape[-1]) for a in arguments)
    return leading, [a.reshape(math.prod(leading), size).astype(working_precision()) for a, size in wide]


@final
class AutomaticEvaluator(Evaluator):
    """Runs a function as a tape where it can be traced to scalars, and these are not too many, else by XLA."""

    def __init__(self) -> None:
        self._tape, self._refusals = TapeEvaluator(MOST_OPERATIONS), list[str]()

    @property
    def name(self) -> str:
        """``"tape"`` if all functions so far run as tapes, else ``"xla"``."""
        return "xla" if self._refusals else "tape"

    @property
    def reason(self) -> str:
        """Why not all functions run as tapes, or that they do."""
        return self._refusals[0] if self._refusals else ALL_TRACED

    def _make(self, function: Function, sizes: Sequence[int], first: int | None) -> PointwiseFunction:
        from ..tape import NotTraceableError

        try:
            return self._tape._make(function, sizes, first)
        except (NotTraceableError, LargeTapeError) as error:
            self._refusals.append(str(error))
        return XlaEvaluator(self._refusals[-1])._make(function, sizes, first)


def choose_evaluator(evaluator: str | Evaluator) -> Evaluator:
    """The evaluator with a name, ``"automatic"``, ``"tape"`` or ``"xla"``; raises ``InvalidInputError`` for another
    one."""
    if isinstance(evaluator, Evaluator):
        return evaluator
    check_evaluator(evaluator)
    return KINDS[evaluator]()


KINDS: dict[str, Callable[[], Evaluator]] = {
    "automatic": AutomaticEvaluator,
    "tape": TapeEvaluator,
    "xla": lambda: XlaEvaluator("it was asked for"),
}


def check_evaluator(evaluator: Any) -> None:
    """Raise ``InvalidInputError`` for what is not the name of an evaluator."""
    if not (isinstance(evaluator, str) and evaluator in KINDS):
        raise InvalidInputError(f"evaluator must be one of {', '.join(map(repr, KINDS))}, got {evaluator!r}")
