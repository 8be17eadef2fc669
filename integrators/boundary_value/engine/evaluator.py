"""Functions of one point, evaluated at many points with their derivatives: on the tape, or compiled by XLA."""

import itertools
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Any, final

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import ClosedJaxpr, jaxpr_as_fun

from ....manifolds import InvalidInputError
from ....manifolds.manifold import working_precision
from ....reading import traced
from ...compilation import compiler_options

Arrays = tuple[np.ndarray, ...]
Function = Callable[..., Any]  # of flat vectors
Evaluated = Callable[..., Arrays]  # of arrays with the points along the first axis

ALL_TRACED = "all functions are traced to scalar operations"


class Evaluator(ABC):
    """Makes of functions of one point, whose arguments are flat vectors of given sizes, functions of many points.

    These take arrays of shape ``(points, size)``, or ``(1, size)`` for what all points share, and return arrays with the
    points along the first axis.
    """

    @property
    @abstractmethod
    def name(self) -> str:
        """``"tape"`` or ``"xla"``."""

    @property
    @abstractmethod
    def reason(self) -> str:
        """Why it was chosen, in words."""

    def values(self, function: Function, *sizes: int) -> Evaluated:
        """The values of a function, a tuple of arrays."""
        return self._made(function, sizes, first=None)

    def derivatives(self, function: Function, *sizes: int) -> Evaluated:
        """``(hessian, gradient, jacobian, vector, *others)`` of ``(scalar, vector, *others) = function(d, ...)`` at ``d = 0``.

        ``sizes`` are those of all arguments; ``d`` is left out of the arguments of what is returned.
        """
        return self._made(function, sizes[1:], first=sizes[0])

    @abstractmethod
    def _made(self, function: Function, sizes: Sequence[int], first: int | None) -> Evaluated:
        """The function of many points; with derivatives by an argument of the size ``first``, if there is one."""


@final
class TapeEvaluator(Evaluator):
    """Runs functions as tapes of scalar instructions, in double precision; nothing is compiled for a problem."""

    @property
    def name(self) -> str:
        """``"tape"``."""
        return "tape"

    @property
    def reason(self) -> str:
        """That all functions are tapes."""
        return ALL_TRACED

    def _made(self, function: Function, sizes: Sequence[int], first: int | None) -> Evaluated:
        from ....tape import Tape

        d = [] if first is None else [jnp.zeros(first)]
        tape = Tape.trace(function, *d, *(jnp.zeros(size) for size in sizes))
        return _OnTape(tape if first is None else tape.expansion(), sizes)


class _OnTape:
    """A tape with arguments and values in rows."""

    def __init__(self, tape: Any, sizes: Sequence[int]) -> None:
        self.tape = tape
        self.sources, self.targets = _Places(sizes), _Places([math.prod(shape) for shape in tape.shapes])
        _ = tape.program

    def __call__(self, *arguments: np.ndarray) -> Arrays:
        count = max(map(len, arguments))
        values = np.empty(count * self.targets.total)
        cuts = self.targets.cuts
        places = self.sources.of([len(a) for a in arguments]), self.targets.of([count] * (len(cuts) - 1))
        given = np.concatenate([a.ravel() for a in arguments])
        self.tape.run(count, (given, places[0], values, places[1]))
        parts = zip(cuts, cuts[1:], self.tape.shapes, strict=False)
        return tuple(values[count * begin : count * end].reshape(count, *shape) for begin, end, shape in parts)


class _Places:
    """Where the numbers of the first point stand, and how far those of the next are, in arrays one after the other."""

    def __init__(self, sizes: Sequence[int]) -> None:
        self.sizes = sizes
        self.cuts = [0, *itertools.accumulate(sizes)]
        self.total = self.cuts[-1]
        self._known: tuple[list[int], np.ndarray] = [], np.empty((0, 2), np.int64)

    def of(self, counts: list[int]) -> np.ndarray:
        """The places where the arrays have these numbers of points; what all points share is one of them."""
        known, places = self._known
        if known != counts or not counts:
            firsts = itertools.accumulate((size * n for size, n in zip(self.sizes, counts, strict=True)), initial=0)
            several = max(counts, default=1) > 1
            rows = [
                (first + k, 0 if several and n == 1 else size)
                for first, size, n in zip(firsts, self.sizes, counts, strict=False)
                for k in range(size)
            ]
            places = np.array(rows, np.int64).reshape(-1, 2)
            self._known = counts, places
        return places


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

    def _made(self, function: Function, sizes: Sequence[int], first: int | None) -> Evaluated:
        def at_point(*arguments: Any) -> Any:
            if first is None:
                return function(*arguments)
            zero = jnp.zeros(first)
            slope = jax.grad(lambda d: function(d, *arguments)[0])
            scalar_slope, push = jax.linearize(lambda d: (slope(d), function(d, *arguments)[1]), zero)
            curvature, jacobian = jax.vmap(push, out_axes=-1)(jnp.eye(first))
            _, vector, *others = function(zero, *arguments)
            return curvature, scalar_slope[0], jacobian, vector, *others

        return _Compiled(traced(at_point, *(jnp.zeros(size) for size in sizes)))


class _Compiled:
    """A traced function, compiled for each number of points."""

    def __init__(self, program: ClosedJaxpr) -> None:
        self.function = jax.vmap(jaxpr_as_fun(program))
        self.executables: dict[int, Any] = {}

    def __call__(self, *arguments: np.ndarray) -> Arrays:
        count = max(len(a) for a in arguments)
        filled = [np.broadcast_to(a, (count, a.shape[1])).astype(working_precision()) for a in arguments]
        if count not in self.executables:
            self.executables[count] = jax.jit(self.function).lower(*filled).compile(compiler_options())
        # Copies: the arrays of XLA are read-only, and the assembly adds to them.
        return tuple(np.array(v, dtype=float, order="C") for v in self.executables[count](*filled))


@final
class Automatic(Evaluator):
    """Runs a function as a tape where it can be traced to scalars, else by XLA."""

    def __init__(self) -> None:
        self._refusals: list[str] = []

    @property
    def name(self) -> str:
        """``"tape"`` if all functions so far run as tapes, else ``"xla"``."""
        return "xla" if self._refusals else "tape"

    @property
    def reason(self) -> str:
        """Why not all functions run as tapes, or that they do."""
        return self._refusals[0] if self._refusals else ALL_TRACED

    def _made(self, function: Function, sizes: Sequence[int], first: int | None) -> Evaluated:
        from ....tape import NotTraceableError

        try:
            return TapeEvaluator()._made(function, sizes, first)
        except NotTraceableError as error:
            self._refusals.append(str(error))
            return XlaEvaluator(str(error))._made(function, sizes, first)


def chosen(evaluator: str | Evaluator) -> Evaluator:
    """The evaluator with a name, ``"automatic"``, ``"tape"`` or ``"xla"``; raises ``InvalidInputError`` for another one."""
    if isinstance(evaluator, Evaluator):
        return evaluator
    kinds = {"automatic": Automatic, "tape": TapeEvaluator, "xla": lambda: XlaEvaluator("it was asked for")}
    if evaluator not in kinds:
        raise InvalidInputError(f"evaluator must be one of {', '.join(map(repr, kinds))}, got {evaluator!r}")
    return kinds[evaluator]()
