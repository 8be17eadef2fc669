"""Indices of entries that an array does not have: JAX takes the nearest entry instead of one, without a word."""

import sys
from collections.abc import Generator, Sequence
from typing import Any

import numpy as np
from jax.core import Tracer
from jax.extend.core import ClosedJaxpr, Literal

from .constant_folding import by_numpy
from .errors import InvalidInputError
from .jaxpr_tools import called_program, programs, scan_parts
from .tracing import LIBRARIES

Equations = tuple[Any, ...]
Values = list[np.ndarray | None]  # of whole numbers and truths that are the same for all input; None for other values
DROPS, PROMISES, CLIPS = "FILL", "PROMISE", "CLIP"  # what JAX does with indices outside, a part of its name


def require_indices(program: ClosedJaxpr, what: str) -> None:
    """Raise if a program takes or sets an entry that an array does not have, by an index that the input does not
    change.

    What asks for it is left alone: ``mode="clip"``, ``mode="fill"``, and an update of which a part lies inside.
    ``what``: whose program it is.
    """
    for within, inputs in _equations(program, [None] * len(program.jaxpr.invars), ()):
        equation = within[-1]
        for axis, indices, count in _indices(equation, inputs):
            outside = indices[(indices < 0) | (indices >= count)]
            if outside.size:
                raise InvalidInputError(_words(within, what, axis, int(outside[0]), count))


def _words(within: Equations, what: str, axis: int, index: int, count: int) -> str:
    equation = within[-1]
    shape, place = equation.invars[0].aval.shape, next(filter(None, map(place_of, reversed(within))), "")
    given = index - shape[axis] if index < 0 else index  # JAX has added the size of the axis to a negative one
    least = -count if count == shape[axis] else 0  # of a slice from an index
    nothing = equation.primitive.name.startswith("scatter")
    there = "leaves the array as it is" if nothing else "takes the nearest entry in its place"
    return (
        f"{what}{place} has index {given} on axis {axis} of an array of shape {shape}, where JAX {there} "
        f"without a word; expected {least} to {count - 1}; try another index, or a larger array; where the entry "
        'is not used, x.at[k].get(mode="clip")'
    )


def _equations(program: Any, inputs: Values, within: Equations) -> Generator[tuple[Equations, Values], None, Values]:
    """The equations of a program and of all programs inside, each behind its caller, with their known inputs.

    The known outputs are returned.
    """
    jaxpr = _open(program)
    known = dict(zip(jaxpr.constvars, map(_whole, getattr(program, "consts", ())), strict=False))
    known |= dict(zip(jaxpr.invars, inputs, strict=True))

    def values(variables: Sequence[Any]) -> Values:
        return [_whole(v.val) if isinstance(v, Literal) else known.get(v) for v in variables]

    for equation in jaxpr.eqns:
        given = values(equation.invars)
        calls = (*within, equation)
        yield calls, given
        own, outputs = called_program(equation), Values()
        if own is not None:
            outputs = yield from _equations(own, given, calls)
        elif equation.primitive.name == "scan":
            fixed = scan_parts(equation.params, given)[0]
            inner = equation.params["jaxpr"]
            yield from _equations(inner, fixed + [None] * (len(_open(inner).invars) - len(fixed)), calls)
        elif equation.primitive.name == "cond":
            for branch in _taken_branches(equation.params["branches"], given[0]):
                yield from _equations(branch, given[1:], calls)
        else:
            for inner in programs(equation):
                yield from _equations(inner, [None] * len(_open(inner).invars), calls)
            outputs = _evaluate(equation, given)
        known |= dict(zip(equation.outvars, outputs, strict=False))
    return values(jaxpr.outvars)


def _open(program: Any) -> Any:
    return getattr(program, "jaxpr", program)


def _taken_branches(branches: Sequence[Any], which: np.ndarray | None) -> Sequence[Any]:
    """The branch that is taken, or all where the input decides."""
    return branches if which is None else [branches[int(np.clip(which, 0, len(branches) - 1))]]


def _whole(value: Any) -> np.ndarray | None:
    """An array of whole numbers or truths; None if it is traced, or something else."""
    kind = getattr(value, "dtype", np.dtype(type(value)))
    return np.asarray(value) if _is_whole(kind) and not isinstance(value, Tracer) else None


def _is_whole(kind: Any) -> bool:
    return isinstance(kind, np.dtype) and kind.kind in "iub"


def _evaluate(equation: Any, inputs: Values) -> Values:
    """The known output of an equation without programs in it, or none."""
    given = [a for a in inputs if a is not None]
    simple = len(equation.outvars) == 1 and _is_whole(equation.outvars[0].aval.dtype) and len(given) == len(inputs)
    return [by_numpy(equation, given)] if simple else []


def _indices(equation: Any, inputs: Values) -> list[tuple[int, np.ndarray, int]]:
    """The axis, the indices and the number of choices, for an equation that takes or sets entries by known indices."""
    name, params = equation.primitive.name, equation.params
    if name not in ("dynamic_slice", "dynamic_update_slice", "gather") and not name.startswith("scatter"):
        return []
    shape = equation.invars[0].aval.shape
    sizes, starts = [1] * len(shape), list[tuple[int, np.ndarray | None]]()
    if name == "dynamic_slice":
        sizes, starts = params["slice_sizes"], list(enumerate(inputs[1:]))
    elif name == "dynamic_update_slice":
        sizes, starts = equation.invars[1].aval.shape, list(enumerate(inputs[2:]))
    elif inputs[1] is not None and name == "gather":
        sizes, starts = params["slice_sizes"], _taken_entries(params, inputs[1])
    elif inputs[1] is not None:
        starts = _set_entries(params, inputs[1], shape)
    return [(axis, np.ravel(a), shape[axis] - sizes[axis] + 1) for axis, a in starts if a is not None]


def _taken_entries(params: dict[str, Any], indices: np.ndarray) -> list[tuple[int, np.ndarray | None]]:
    """Axes and indices of entries that are taken, unless it is said what is to happen where there are none."""
    mode = str(params["mode"])
    # Of a slice that vmap has mapped; of one that asks for it JAX does not know that its only index is unique.
    mapped = CLIPS in mode and indices.ndim == 1 and params["unique_indices"]
    axes = params["dimension_numbers"].start_index_map if PROMISES in mode or mapped else ()
    return [(axis, indices[..., k]) for k, axis in enumerate(axes)]


def _set_entries(
    params: dict[str, Any], indices: np.ndarray, shape: tuple[int, ...]
) -> list[tuple[int, np.ndarray | None]]:
    """Axes and indices of entries that are set, if all are dropped."""
    numbers = params["dimension_numbers"]
    axes = [
        (axis, k) for k, axis in enumerate(numbers.scatter_dims_to_operand_dims) if axis in numbers.inserted_window_dims
    ]
    found = [(axis, indices[..., k]) for axis, k in axes]
    outside = [(a < 0) | (a >= shape[axis]) for axis, a in found]
    dropped = DROPS in str(params["mode"]) and outside and np.all(np.any(outside, axis=0))
    return [*found] if dropped else []


def place_of(equation: Any) -> str:
    """The user's function that an equation comes from, its line and file; empty where JAX does not know them."""
    modules = [*sys.modules.items()]
    ours = {getattr(own, "__file__", None) for name, own in modules if name.partition(".")[0] in LIBRARIES}
    traceback = equation.source_info.traceback
    for frame in traceback.frames if traceback is not None else ():
        if frame.file_name not in ours and not frame.file_name.startswith("<frozen"):
            return f", in {frame.function_name}, line {frame.line_num} of {frame.file_name},"
    return ""
