"""Functions of one point, evaluated at many points with their derivatives: on the tape, or compiled by XLA."""

import itertools
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Hashable, Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Self, final

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import ClosedJaxpr, jaxpr_as_fun

from ..manifolds import InvalidInputError
from ..manifolds.numerics.precision import working_precision
from ..reading import traced
from .compilation import compiler_options
from .program_keys import content_key

if TYPE_CHECKING:
    from ..tape import Tape

Arrays = tuple[np.ndarray, ...]
Function = Callable[..., Any]  # of flat vectors

MOST_TAPES = 256
_tapes: dict[Hashable, "Tape"] = {}  # by what they compute, the last one that was asked for at the end

ALL_TRACED = "all functions are traced to scalar operations"


class Evaluated(ABC):
    """A function of flat vectors, evaluated at many points."""

    def __call__(self, *arguments: np.ndarray) -> Arrays:
        """The values for arrays of shape ``(points, size)``."""
        return self.at(1, *arguments)

    @abstractmethod
    def at(self, axes: int, *arguments: np.ndarray) -> Arrays:
        """The values for arrays with some leading axes in common, of length 1 where an array is shared."""


class Evaluator(ABC):
    """Makes of functions of one point, whose arguments are flat vectors of given sizes, functions of many points."""

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
        """``(hessian, gradient, *jacobians, *vectors, *others)`` at ``d = 0`` of ``function(d, ...)``.

        It returns ``(scalar, vectors, *others)``, where ``vectors`` is an array or a tuple of them. ``sizes`` are those
        of all arguments; ``d`` is left out of the arguments of what is returned.
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
        d = [] if first is None else [np.zeros(first)]
        return _OnTape(_tape(function, [*d, *(np.zeros(size) for size in sizes)], first is not None))


def _tape(function: Function, examples: list[np.ndarray], expanded: bool) -> "Tape":
    """The tape of a function, or of its expansion; functions that compute the same have one."""
    from ..tape import Tape
    from ..tape.trace import flat

    program = flat(function, *examples)
    content = content_key(program.jaxpr, differentiated=expanded)
    key = content, program.result, expanded
    tape = None if content is None else _tapes.pop(key, None)
    if tape is None:
        tape = Tape.read(program)
        tape = tape.expansion() if expanded else tape
    if content is not None:
        _tapes[key] = tape
        if len(_tapes) > MOST_TAPES:
            _tapes.pop(next(iter(_tapes)), None)
    return tape


@dataclass(frozen=True, eq=False)
class _Plan:
    """Where a tape finds the numbers of some arrays, and where it writes: fixed by their shapes."""

    count: int
    filled: list[tuple[int, ...] | None]  # shapes to which arrays are broadcast first
    sources: np.ndarray  # the place of the number of the first point, and how far that of the next is
    targets: np.ndarray
    size: int
    values: list[tuple[int, int, tuple[int, ...]]]  # the parts of what is written, and their shapes

    @classmethod
    def of(cls, axes: int, given: Sequence[tuple[int, ...]], found: Sequence[tuple[int, ...]]) -> Self:
        """The plan for arrays with leading axes, and for the shapes of the values at a point."""
        leading = np.broadcast_shapes(*(shape[:axes] for shape in given))
        count, sizes = math.prod(leading), [math.prod(shape[axes:]) for shape in given]
        shared = [count > 1 and math.prod(shape[:axes]) == 1 for shape in given]
        alone = [one or shape[:axes] == leading for one, shape in zip(shared, given, strict=True)]
        filled = [None if own else (*leading, size) for own, size in zip(alone, sizes, strict=True)]
        sources = _rows((size, 1 if one else count) for one, size in zip(shared, sizes, strict=True))
        written = [math.prod(shape) for shape in found]
        cuts = [count * end for end in itertools.accumulate(written, initial=0)]
        values = [(*pair, (*leading, *shape)) for pair, shape in zip(itertools.pairwise(cuts), found, strict=True)]
        return cls(count, filled, sources, _rows((size, count) for size in written), cuts[-1], values)


def _rows(arrays: Iterable[tuple[int, int]]) -> np.ndarray:
    """Where the numbers of points stand in arrays one after the other, of these widths and lengths; shared where that
    is one."""
    rows, first = list[tuple[int, int]](), 0
    for size, length in arrays:
        rows += [(first + k, size if length > 1 else 0) for k in range(size)]
        first += size * length
    return np.array(rows, np.int64).reshape(-1, 2)


@final
class _OnTape(Evaluated):
    """A tape with arguments and values in rows."""

    def __init__(self, tape: Any) -> None:
        self.tape = tape
        self._planned: tuple[Any, _Plan | None] = None, None
        _ = tape.program

    def at(self, axes: int, *arguments: np.ndarray) -> Arrays:
        key, (known, plan) = (axes, *[a.shape for a in arguments]), self._planned
        if plan is None or known != key:
            plan = _Plan.of(axes, key[1:], self.tape.shapes)
            self._planned = key, plan
        rows = [
            (a if to is None else np.broadcast_to(a, to)).ravel() for a, to in zip(arguments, plan.filled, strict=True)
        ]
        values = np.empty(plan.size)
        self.tape.run(plan.count, (np.concatenate(rows), plan.sources, values, plan.targets))
        return tuple([values[first:last].reshape(shape) for first, last, shape in plan.values])


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
            curvature, jacobians = jax.vmap(push, out_axes=-1)(jnp.eye(first))
            return curvature, scalar_slope[0], *jax.tree.leaves((jacobians, function(zero, *arguments)[1:]))

        return _Compiled(traced(at_point, *(np.zeros(size) for size in sizes)))


@final
class _Compiled(Evaluated):
    """A traced function, compiled for each number of points."""

    def __init__(self, program: ClosedJaxpr) -> None:
        self.function = jax.vmap(jaxpr_as_fun(program))
        self.executables: dict[int, Any] = {}

    def at(self, axes: int, *arguments: np.ndarray) -> Arrays:
        leading = np.broadcast_shapes(*(a.shape[:axes] for a in arguments))
        count = math.prod(leading)
        wide = ((np.broadcast_to(a, (*leading, a.shape[-1])), a.shape[-1]) for a in arguments)
        filled = [a.reshape(count, size).astype(working_precision()) for a, size in wide]
        if count not in self.executables:
            self.executables[count] = jax.jit(self.function).lower(*filled).compile(compiler_options())
        # Copies: the arrays of XLA are read-only, and the assembly adds to them.
        found = self.executables[count](*filled)
        return tuple(np.array(v, dtype=float, order="C").reshape(*leading, *v.shape[1:]) for v in found)


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
        from ..tape import NotTraceableError

        try:
            return TapeEvaluator()._made(function, sizes, first)
        except NotTraceableError as error:
            self._refusals.append(str(error))
            return XlaEvaluator(str(error))._made(function, sizes, first)


def chosen(evaluator: str | Evaluator) -> Evaluator:
    """The evaluator with a name, ``"automatic"``, ``"tape"`` or ``"xla"``; raises ``InvalidInputError`` for another
    one."""
    if isinstance(evaluator, Evaluator):
        return evaluator
    kinds = {"automatic": Automatic, "tape": TapeEvaluator, "xla": lambda: XlaEvaluator("it was asked for")}
    if evaluator not in kinds:
        raise InvalidInputError(f"evaluator must be one of {', '.join(map(repr, kinds))}, got {evaluator!r}")
    return kinds[evaluator]()
