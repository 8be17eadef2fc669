"""From JAX functions to graphs of scalars: the jaxpr is read equation by equation, values only."""

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any, NamedTuple

import casadi as ca
import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import ClosedJaxpr, Jaxpr, Literal, gensym, jaxpr_as_fun, new_jaxpr_eqn

from ..constant_folding import evaluate
from ..errors import TRACEABLE, InvalidInputError, RetraxError
from ..jaxpr_tools import CALLS, HIGH, called_program, is_in_scalars, name_of, scan_parts
from ..tracing import trace_program, users_line
from .arrays import (
    Complex,
    Entries,
    NotRealError,
    NotTraceableError,
    Scalars,
    column,
    is_complex,
    is_known,
    parts,
    scalars,
    take,
)
from .elementwise import elementwise, select_n
from .graph import Graph, Mark
from .guarded_rules import BY_MARKS
from .linear import LINEAR, inverse
from .liveness import RULES, live_equations, open_jaxpr
from .roots import PRIMITIVE as ROOT
from .roots import roots
from .structural_rules import STRUCTURAL_RULES, stack

BACKWARD = {"custom_vjp_call", "CustomVJPTraced"}  # what has a rule in reverse mode only
LONGEST_LOOP = 1000  # iterations of a loop that is written out


class Tracer:
    """Reads jaxprs into one graph."""

    def __init__(self, graph: Graph) -> None:
        self.graph = graph
        self._roots: dict[Any, tuple[Any, list[Entries]]] = {}  # with what keeps the identities in the keys

    def run(self, jaxpr: Any, constants: Any, arguments: list[Any], wanted: list[bool] | None = None) -> list[Any]:
        """Values of a jaxpr, None for unwanted values; an argument that no wanted value needs may be None."""
        wanted = [True] * len(jaxpr.outvars) if wanted is None else wanted
        values: dict[Any, Any] = {}
        # Since JAX 0.11 the variables of constants that a program lacks are among those of its arguments.
        given = [*map(_entries, constants), *arguments]
        values.update(zip([*jaxpr.constvars, *jaxpr.invars], given, strict=True))
        for eqn, outputs, inputs in live_equations(jaxpr, wanted)[0]:
            arrays = [_read(values, v) if need else None for v, need in zip(eqn.invars, inputs, strict=True)]
            values.update(zip(eqn.outvars, self._equation(eqn, arrays, outputs), strict=True))
        return [_read(values, v) if want else None for v, want in zip(jaxpr.outvars, wanted, strict=True)]

    def evaluate(self, jaxpr: Any, arguments: list[Any], wanted: list[bool] | None = None) -> list[Any]:
        """Values of a jaxpr that may hold its constants."""
        return self.run(open_jaxpr(jaxpr), getattr(jaxpr, "consts", ()), arguments, wanted)

    def _equation(self, eqn: Any, arrays: list[Any], wanted: list[bool]) -> list[Any]:
        """Values of an equation; it is refused by name where its rule does not take this, as complex numbers."""
        try:
            return self._values(eqn, arrays, wanted)
        except RetraxError:
            raise
        except NotRealError:
            raise NotTraceableError(name_of(eqn), "here of complex numbers") from None
        except Exception as error:  # of NumPy or CasADi, any
            raise NotTraceableError(name_of(eqn), f"whose rule does not take this: {error}") from error

    def _values(self, eqn: Any, arrays: list[Any], wanted: list[bool]) -> list[Any]:
        name, params = name_of(eqn), eqn.params
        if name in RULES or eqn.primitive.name == HIGH:
            return self._custom(eqn, arrays)
        if name in CALLS:
            return self.evaluate(called_program(eqn), arrays, wanted)
        if name in _CONTROL:
            return _CONTROL[name](self, eqn, arrays)
        if name in STRUCTURAL_RULES:
            return _as_list(STRUCTURAL_RULES[name](params, *arrays))
        if is_known(*arrays):
            if jnp.issubdtype(eqn.outvars[0].aval.dtype, jax.dtypes.extended):
                raise NotTraceableError(name, "which makes a random key")
            return list(evaluate(eqn, arrays))
        if name in BY_MARKS:
            return [BY_MARKS[name](self.graph, eqn, *arrays)]
        if name in LINEAR:
            return _as_list(LINEAR[name](params, *arrays))
        kind = np.dtype(eqn.outvars[0].aval.dtype).kind
        value = elementwise(name, {**params, "whole": kind in "iu", "truth": kind == "b"}, arrays)
        if value is None:
            of = " for complex numbers" if any(is_complex(a) for a in arrays) else ""
            raise NotTraceableError(name, f"which has no rule{of}")
        return [value]

    def _scan(self, eqn: Any, arrays: list[Entries]) -> list[Entries]:
        params, length = eqn.params, eqn.params["length"]
        _require_short("scan", length)
        fixed, carry, along = scan_parts(params, arrays)
        rows: dict[int, list[Entries]] = {}
        for k in reversed(range(length)) if params["reverse"] else range(length):
            out = self.evaluate(params["jaxpr"], [*fixed, *carry, *(_row(a, k) for a in along)])
            carry, rows[k] = out[: len(carry)], out[len(carry) :]
        empty = [np.zeros(v.aval.shape, v.aval.dtype) for v in eqn.outvars[len(carry) :]]
        return [
            *carry,
            *([stack([rows[k][i] for k in range(length)]) for i in range(len(empty))] if length else empty),
        ]

    def _while(self, eqn: Any, arrays: list[Entries]) -> list[Entries]:
        params = eqn.params
        first, second = params["cond_nconsts"], params["cond_nconsts"] + params["body_nconsts"]
        of_test, of_body, carry = arrays[:first], arrays[first:second], arrays[second:]
        for _ in range(LONGEST_LOOP):
            (going,) = self.evaluate(params["cond_jaxpr"], [*of_test, *carry])
            if not is_known(going):
                raise NotTraceableError("while", "whose number of iterations depends on the input")
            if not going:
                return carry
            carry = self.evaluate(params["body_jaxpr"], [*of_body, *carry])
        raise NotTraceableError("while", f"with more than {LONGEST_LOOP} iterations")

    def _cond(self, eqn: Any, arrays: list[Entries]) -> list[Entries]:
        which, branches = arrays[0], eqn.params["branches"]
        last = len(branches) - 1
        if isinstance(which, np.ndarray):
            return self.evaluate(branches[int(np.clip(which, 0, last))], arrays[1:])
        found = [self.evaluate(branch, arrays[1:]) for branch in branches]
        return [select_n({}, which, *values) for values in zip(*found, strict=True)]

    def _platform_index(self, eqn: Any, arrays: list[Entries]) -> list[Entries]:
        platforms = eqn.params["platforms"]
        return [np.asarray(next(k for k, names in enumerate(platforms) if names is None or "cpu" in names))]

    def _stop_gradient(self, eqn: Any, arrays: list[Entries]) -> list[Entries]:
        return [self._without_slopes(a) for a in arrays]

    def _without_slopes(self, a: Entries) -> Entries:
        if isinstance(a, Complex):
            return Complex(self._without_slopes(a.real), self._without_slopes(a.imag))
        return a if isinstance(a, np.ndarray) else scalars(self.graph.constant(a.values), a.shape)

    def _linear_solve(self, eqn: Any, arrays: list[Entries]) -> list[Entries]:
        """``x = A^-1 b`` for the real matrix ``A`` that is read off the linear map, of real and imaginary parts."""
        counts, matvec = eqn.params["const_lengths"], eqn.params["jaxprs"].matvec
        fixed, right = arrays[: counts.matvec], arrays[sum(counts) :]
        leaves = [
            (v.aval.shape, is_complex(b) or np.dtype(v.aval.dtype).kind == "c")
            for v, b in zip(eqn.outvars, right, strict=True)
        ]
        side = _flat(right, leaves)
        unknown = ca.SX.sym("x", side.shape[0])
        images = self.evaluate(matvec, [*fixed, *_arrays(unknown, leaves)])
        inverted = self._mark_inverse(ca.jacobian(_flat(images, leaves), unknown))
        return _arrays(ca.mtimes(inverted, side), leaves)

    def _mark_inverse(self, matrix: ca.SX) -> ca.SX:
        """The inverse with the derivative ``dB = -B dA B``, which needs none of the elimination."""
        value = inverse(matrix)
        symbols = self.graph.symbols(value.nnz())
        marked = ca.SX(value.sparsity(), symbols)
        entries = zip(*matrix.sparsity().get_triplet(), strict=True)

        def slope() -> ca.SX:
            moves = (-ca.mtimes(marked[:, i], marked[j, :]) for i, j in entries)
            return ca.horzcat(*(_nonzeros(ca.project(move, value.sparsity())) for move in moves))

        self.graph.add(Mark(symbols, _nonzeros(value), _nonzeros(matrix), slope))
        return marked

    def _custom(self, eqn: Any, arrays: list[Entries]) -> list[Entries]:
        """A function with a derivative of its own, which JAX knows."""
        values = self.evaluate(called_program(eqn), arrays)
        return values if is_in_scalars(eqn) else self._mark_derivative(eqn, arrays, values)

    def _root(self, eqn: Any, arrays: list[Any]) -> list[Entries]:
        """A root with the derivatives of the implicit function theorem; one that is met again, in a derivative of
        itself, is the same."""
        jaxpr = eqn.params["jaxpr"]
        key = id(jaxpr), eqn.params["axes"], *map(id, arrays)
        if key not in self._roots:
            found = roots(eqn.params, arrays, self._system, self.graph.loop)
            self._roots[key] = (jaxpr, arrays), self._mark_derivative(eqn, arrays, found)
        return self._roots[key][1]

    def _system(self, jaxpr: Any, operands: list[Any]) -> ca.Function:
        """The residual of an equation for a root, and its Jacobian, as a function of the unknowns and the operands."""
        unknown = ca.SX.sym("c", jaxpr.invars[-1].aval.size)
        given = [ca.SX.sym(f"a{k}", int(np.prod(a.shape))) for k, a in enumerate(operands)]
        inner = Tracer(Graph([unknown, *given]))
        constants = [scalars(symbols, a.shape) for symbols, a in zip(given, operands, strict=True)]
        (value,) = inner.run(jaxpr, constants, [scalars(unknown, unknown.shape[:1])])
        residual = column(value)
        found = inner.graph.resolve_marks([residual, inner.graph.jacobian(residual, unknown)])
        return ca.Function("residual", [unknown, ca.vertcat(ca.SX(0, 1), *given)], found, {"cse": True})

    def _mark_derivative(self, eqn: Any, arrays: list[Any], values: list[Entries]) -> list[Entries]:
        """The values of an equation with a derivative of its own, as symbols of the graph."""
        if any(is_complex(a) for a in (*arrays, *values)):
            raise NotTraceableError(name_of(eqn), "here of complex numbers")
        varying = [k for k, a in enumerate(arrays) if isinstance(a, Scalars) and _is_real(eqn.invars[k])]
        smooth = [k for k, v in enumerate(values) if isinstance(v, Scalars) and _is_real(eqn.outvars[k])]
        if not varying or not smooth:
            return values
        rule = partial(self._slope, eqn, arrays, varying, smooth)
        value = ca.vertcat(*(column(values[k]) for k in smooth))
        symbols = self.graph.symbols(value.shape[0])
        self.graph.add(Mark(symbols, value, ca.vertcat(*(column(arrays[k]) for k in varying)), rule))
        ends = np.cumsum([0, *(math.prod(values[k].shape) for k in smooth)]).tolist()
        for k, part in zip(smooth, ca.vertsplit(symbols, ends), strict=True):
            values[k] = scalars(part, values[k].shape)
        return values

    def _slope(self, eqn: Any, arrays: list[Entries], varying: list[int], smooth: list[int]) -> ca.SX:
        """Derivative of the values ``smooth`` of a function by its arguments ``varying``, by its own rule."""
        call, forward = _function(eqn), name_of(eqn) not in BACKWARD

        def image(arguments: list[Any], directions: list[Any]) -> Any:
            def inner(*moving: Any) -> list[Any]:
                full = list(arguments)
                for k, value in zip(varying, moving, strict=True):
                    full[k] = value
                out = call(*full)
                return [out[k] for k in smooth]

            point = [arguments[k] for k in varying]
            return jax.jvp(inner, point, directions)[1] if forward else jax.vjp(inner, *point)[1](directions)

        shapes = [eqn.invars[k].aval for k in varying] if forward else [eqn.outvars[k].aval for k in smooth]
        examples = ([np.zeros(v.shape, v.dtype) for v in part] for part in ([v.aval for v in eqn.invars], shapes))
        with readable():
            program = trace_program(image, *examples)
        symbols = [ca.SX.sym("t", int(np.prod(s.shape))) for s in shapes]
        directions = [scalars(t, s.shape) for t, s in zip(symbols, shapes, strict=True)]
        images = ca.vertcat(*(column(a) for a in self.evaluate(program, [*arrays, *directions])))
        matrix = ca.jacobian(images, ca.vertcat(*symbols))
        return matrix if forward else matrix.T


def _function(eqn: Any) -> Callable[..., list[Any]]:
    """One equation of a jaxpr as a function of JAX, which has its derivatives."""
    variable = gensym()
    ins, outs = ([variable(v.aval) for v in part] for part in (eqn.invars, eqn.outvars))
    alone = new_jaxpr_eqn(ins, outs, eqn.primitive, eqn.params, eqn.effects)
    debug = open_jaxpr(called_program(eqn) or eqn.params["jaxpr"]).debug_info
    return jaxpr_as_fun(ClosedJaxpr(Jaxpr([], ins, outs, [alone], eqn.effects, debug), []))


def _as_list(value: Entries | list[Entries]) -> list[Entries]:
    return value if isinstance(value, list) else [value]


def _read(values: dict[Any, Entries], variable: Any) -> Entries:
    return np.asarray(variable.val) if isinstance(variable, Literal) else values[variable]


def _entries(constant: Any) -> Entries:
    return constant if isinstance(constant, Scalars | Complex) else np.asarray(constant)


def _is_real(variable: Any) -> bool:
    return np.dtype(variable.aval.dtype).kind == "f"


def _flat(arrays: list[Entries], leaves: list[tuple[tuple[int, ...], bool]]) -> ca.SX:
    """All scalars of arrays, one column; ``leaves`` has their shapes, and which are complex."""
    halves = ((parts(a) if pair else (a,)) for a, (_, pair) in zip(arrays, leaves, strict=True))
    return ca.vertcat(*(column(half) for group in halves for half in group))


def _arrays(values: ca.SX, leaves: list[tuple[tuple[int, ...], bool]]) -> list[Entries]:
    """The arrays with these scalars."""
    found: list[Entries] = []
    begin = 0
    for shape, pair in leaves:
        size = math.prod(shape)
        halves = [scalars(values[begin + k * size : begin + (k + 1) * size], shape) for k in range(1 + pair)]
        found.append(Complex(*halves) if pair else halves[0])
        begin += size * len(halves)
    return found


def _nonzeros(matrix: ca.SX) -> ca.SX:
    return matrix.nz[:]


def _require_short(name: str, length: int) -> None:
    if length > LONGEST_LOOP:
        raise NotTraceableError(name, f"with {length} iterations, where at most {LONGEST_LOOP} are written out")


def _row(a: Entries, k: int) -> Entries:
    shape = a.shape[1:]
    count = int(np.prod(shape))
    return take(a, np.arange(k * count, (k + 1) * count).reshape(shape))


_CONTROL: dict[str, Callable[[Tracer, Any, list[Entries]], list[Entries]]] = {
    "cond": Tracer._cond,
    ROOT: Tracer._root,
    "custom_linear_solve": Tracer._linear_solve,
    "platform_index": Tracer._platform_index,
    "scan": Tracer._scan,
    "stop_gradient": Tracer._stop_gradient,
    "while": Tracer._while,
}


class Flat(NamedTuple):
    """A function of pytrees of arrays as a jaxpr of their leaves: its closed jaxpr, examples, and the structure of its
    values."""

    jaxpr: Any
    examples: tuple[Any, ...]
    result: Any

    def zeros(self) -> Any:
        """Zeros like the values."""
        return jax.tree.unflatten(self.result, [np.zeros(a.shape, a.dtype) for a in self.jaxpr.out_avals])


def flat(function: Callable[..., Any], *examples: Any) -> Flat:
    """A function as JAX traces it; the values of the examples play no part."""
    leaves, structure = jax.tree.flatten(examples)

    def of_leaves(*leaves: Any) -> Any:
        found, shape = jax.tree.flatten(function(*jax.tree.unflatten(structure, leaves)))
        result.append(shape)
        return found

    result: list[Any] = []
    jaxpr = trace_program(of_leaves, *map(np.asarray, leaves))
    return Flat(jaxpr, examples, result[-1])


@contextmanager
def readable() -> Iterator[None]:
    """A time in which functions of a user are traced: where JAX cannot, that is an ``InvalidInputError``."""
    try:
        yield
    except (jax.errors.JAXTypeError, jax.errors.JAXIndexError) as error:
        where = users_line(error)
        raise InvalidInputError(
            f"JAX cannot trace the function{where and f', in {where}'} ({type(error).__name__}); {TRACEABLE}"
        ) from error


def trace(function: Flat) -> tuple[Graph, list[Entries]]:
    """The graph of a function, and its values leaf by leaf.

    Inputs are the leaves of its examples: real ones a column each, complex ones two. Raises ``NotTraceableError`` for
    what cannot be written as a graph of scalars.
    """
    inputs: list[ca.SX] = []
    arrays: list[Entries] = []
    for k, leaf in enumerate(map(np.asarray, jax.tree.leaves(function.examples))):
        symbols = [ca.SX.sym(f"{name}{k}", leaf.size) for name in ("xy" if np.iscomplexobj(leaf) else "x")]
        inputs += symbols
        halves: list[Entries] = [scalars(s, leaf.shape) for s in symbols]
        arrays.append(halves[0] if len(halves) == 1 else Complex(*halves))
    graph = Graph(inputs)
    return graph, Tracer(graph).evaluate(function.jaxpr, arrays)
