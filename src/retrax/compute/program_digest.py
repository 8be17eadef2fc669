"""Keys of programs that JAX traced, equal for programs that compute the same, so that compiled programs are found
again."""

import itertools
import sys
from enum import Enum
from hashlib import blake2b
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import ShapedArray
from jax.extend.core import ClosedJaxpr, Jaxpr, Literal, jaxpr_as_fun

from ..jaxpr_tools import expansion, scan_parts

# Rules of derivatives, which a program that is not differentiated any more does not run; they are made anew in every
# trace.
UNUSED = {
    "custom_jvp_call": {"jvp_jaxpr_fun"},
    "custom_vjp_call": {"fwd_jaxpr_thunk", "bwd"},
    "custom_vjp_call_jaxpr": {"fwd_jaxpr_thunk", "bwd"},
}
# How the inputs and outputs of a loop are parted in JAX 0.11 and later, objects of its own; `scan_parts` reads them.
PARTED = {"ft_in", "ft_out"}
PLAIN = bool, int, float, complex, str, bytes, type(None)
# No device is asked for.
NOWHERE = "UnspecifiedValue", "Mesh(axis_sizes=(), axis_names=())", "AbstractMesh((), axis_types=())"
_serial = itertools.count()


def program_key(closed: ClosedJaxpr) -> bytes:
    """A digest that two programs share only if they compute the same of equal constants and arguments.

    Names of variables and places in the source play no part. What is not known here makes a program differ from all
    others.
    """
    return _Writer().jaxpr(closed.jaxpr)


def content_key(closed: ClosedJaxpr, differentiated: bool = False) -> bytes | None:
    """The digest of a program with its constants; None where something in it is not known.

    For a program that is ``differentiated`` that is so where a function in it has a derivative of its own.
    """
    writer = _Writer()
    key = _digest(writer.value(closed))
    return None if writer.foreign or (differentiated and writer.has_rules) else key


def value_of(known: dict[Any, Any], variable: Any) -> Any:
    """The value of a variable of a program that is evaluated, or of a number in it."""
    return variable.val if isinstance(variable, Literal) else known[variable]


def outputs_of(jaxpr: Jaxpr, equation: Any, known: dict[Any, Any]) -> list[Any]:
    """The outputs of one equation of a program."""
    variables = list({v: None for v in equation.invars if not isinstance(v, Literal)})
    alone = Jaxpr([], variables, equation.outvars, [equation], equation.effects, jaxpr.debug_info)
    return jaxpr_as_fun(ClosedJaxpr(alone, []))(*(known[v] for v in variables))


class _Writer:
    """Writes the parts of one program down; jaxprs that occur again are read once."""

    def __init__(self) -> None:
        self.known: dict[int, bytes] = {}
        self.kinds: dict[Any, str] = {}
        self.kept: list[Any] = []
        self.foreign = False  # whether something was met that is not known here
        self.has_rules = False  # whether rules of derivatives were left out

    def jaxpr(self, jaxpr: Jaxpr) -> bytes:
        """The digest of an open jaxpr."""
        if id(jaxpr) not in self.known:
            self.known[id(jaxpr)] = self._read(jaxpr)
        return self.known[id(jaxpr)]

    def _read(self, jaxpr: Jaxpr) -> bytes:
        given, count = [*jaxpr.constvars, *jaxpr.invars], itertools.count()
        numbers: dict[Any, int] = dict(zip(given, count, strict=False))
        lines: list[Any] = [len(jaxpr.constvars), [self._kind(v.aval) for v in given]]

        def read(atom: Any) -> Any:
            return self._literal(atom) if isinstance(atom, Literal) else numbers[atom]

        for eqn in jaxpr.eqns:
            name = eqn.primitive.name
            inputs = [read(v) for v in eqn.invars]
            numbers.update(zip(eqn.outvars, count, strict=False))
            unused = UNUSED.get(name, ())
            self.has_rules |= name in UNUSED
            params = [(k, self.value(v)) for k, v in eqn.params.items() if k not in unused and k not in PARTED]
            params += [("parts", list(map(len, scan_parts(eqn.params, inputs))))] if name == "scan" else []
            lines.append((name, inputs, [self._kind(v.aval) for v in eqn.outvars], params, self._kind(eqn.ctx)))
        lines.append([read(v) for v in jaxpr.outvars])
        return _digest(lines)

    def _literal(self, literal: Literal) -> tuple[str, Any]:
        return self._kind(literal.aval), _content(literal.val)

    def _kind(self, kind: Any) -> str:
        """A digest of words on what is equal where its words are: the kind of an array, the settings of an equation."""
        if kind not in self.kinds:
            shape, dtype = getattr(kind, "shape", None), getattr(kind, "dtype", None)
            words = f"{type(kind).__name__} {shape} {dtype} {getattr(kind, 'weak_type', '')} {kind!r}"
            self.kinds[kind] = blake2b(words.encode(), digest_size=16).hexdigest()
        return self.kinds[kind]

    def value(self, value: Any) -> Any:
        """A parameter of an equation."""
        if type(value) in PLAIN:
            return type(value).__name__, value
        if isinstance(value, tuple | list):
            return type(value).__qualname__, [self.value(item) for item in value]
        if isinstance(value, ClosedJaxpr):
            return "closed", self.jaxpr(value.jaxpr), [_content(c) for c in value.consts]
        if isinstance(value, Jaxpr):
            return "open", self.jaxpr(value)
        if isinstance(value, Enum | type | np.dtype):
            return type(value).__name__, repr(value)
        if isinstance(value, PLAIN):
            return type(value).__name__, repr(value)
        if isinstance(value, dict):
            return "dict", [(self.value(k), self.value(v)) for k, v in value.items()]
        if isinstance(value, frozenset):
            return "frozenset", sorted(repr(self.value(item)) for item in value)
        if isinstance(value, np.ndarray | np.generic | jax.Array):
            return _content(value)
        if isinstance(value, ShapedArray) or _is_nowhere(value):
            return self._kind(value)
        if _is_high(value):
            return self._high(value)
        if _is_found_by_name(value):
            return "function", value.__module__, value.__qualname__
        self.foreign = True
        return "unknown", next(_serial)

    def _high(self, high: Any) -> tuple[str, Any]:
        """A primitive of JAX that is an object: its class, and its parameters if they say all of it, else what it
        computes."""
        before, self.foreign = self.foreign, False
        params = self.value(high.params)
        unknown, self.foreign = self.foreign, before
        if not unknown:
            return type(high).__name__, params
        self.has_rules = True  # functions among the parameters may be some
        program = expansion(high)
        self.kept.append(program)  # what is known goes by its identity
        return type(high).__name__, self.value(program)


def _is_nowhere(value: Any) -> bool:
    """Whether this is JAX's word for a place or a layout that nobody chose."""
    return type(value).__module__.startswith("jax.") and any(words in repr(value) for words in NOWHERE)


def _is_found_by_name(value: Any) -> bool:
    """Whether a value is a function of a module of JAX, such as a generator of random numbers."""
    module, name = getattr(value, "__module__", None) or "", getattr(value, "__qualname__", "")
    return module.startswith("jax.") and getattr(sys.modules.get(module), name, None) is value


def _is_high(value: Any) -> bool:
    """Whether this is a primitive of JAX that is an object."""
    kinds = type(value).__mro__
    return kinds[0].__module__.startswith("jax.") and any(kind.__name__ == "HiPrim" for kind in kinds)


def _content(value: Any) -> tuple[str, str, bytes]:
    """An array by its entries."""
    if isinstance(value, jax.Array) and jnp.issubdtype(value.dtype, jax.dtypes.prng_key):
        return repr(value.dtype), *_content(jax.random.key_data(value))[1:]
    array = np.asarray(value)
    return str(array.shape), array.dtype.str, array.tobytes()


def _digest(*parts: Any) -> bytes:
    return blake2b(repr(parts).encode()).digest()
