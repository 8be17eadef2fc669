"""JAX's primitives on arrays whose entries are all known, by NumPy where that is simple: XLA would compile each of
them."""

from typing import Any

import numpy as np

_UFUNCS: dict[str, Any] = {
    "abs": np.abs,
    "add": np.add,
    "add_any": np.add,
    "and": np.logical_and,
    "conj": np.conj,
    "copy": np.asarray,
    "cos": np.cos,
    "eq": np.equal,
    "exp": np.exp,
    "ge": np.greater_equal,
    "gt": np.greater,
    "imag": np.imag,
    "le": np.less_equal,
    "log": np.log,
    "lt": np.less,
    "max": np.maximum,
    "min": np.minimum,
    "mul": np.multiply,
    "ne": np.not_equal,
    "neg": np.negative,
    "not": np.logical_not,
    "or": np.logical_or,
    "real": np.real,
    "sign": np.sign,
    "sin": np.sin,
    "sqrt": np.sqrt,
    "square": np.square,
    "sub": np.subtract,
    "tan": np.tan,
    "tanh": np.tanh,
    "stop_gradient": np.asarray,
}
_LOGICAL = {"and", "or", "not", "reduce_and", "reduce_or"}
_REDUCTIONS: dict[str, Any] = {
    "reduce_and": np.all,
    "reduce_max": np.max,
    "reduce_min": np.min,
    "reduce_or": np.any,
    "reduce_sum": np.sum,
}


def evaluated(eqn: Any, arrays: list[np.ndarray]) -> list[np.ndarray]:
    """The values of one equation of a jaxpr."""
    name, params, out = eqn.primitive.name, eqn.params, eqn.outvars[0].aval
    if name == "iota":
        axis = params["dimension"]
        shape = [1] * len(params["shape"])
        shape[axis] = -1
        return [np.broadcast_to(np.arange(params["shape"][axis]).reshape(shape), params["shape"]).astype(out.dtype)]
    if name == "convert_element_type" and (np.dtype(out.dtype).kind == "c" or arrays[0].dtype.kind != "c"):
        return [arrays[0].astype(out.dtype)]
    if name == "integer_pow":
        with np.errstate(all="ignore"):
            return [
                np.asarray(arrays[0] ** params["y"] if params["y"] >= 0 else 1 / arrays[0] ** -params["y"], out.dtype)
            ]
    if name == "dot_general" and not any(params["dimension_numbers"][1]):  # no axes that both have
        left, right = arrays
        return [np.asarray(np.tensordot(left, right, params["dimension_numbers"][0]), out.dtype)]
    if name == "select_n":
        return [np.asarray(np.choose(arrays[0].astype(int), arrays[1:]), out.dtype)]
    if name in _REDUCTIONS and arrays[0].size and (name not in _LOGICAL or out.dtype == np.bool_):
        with np.errstate(all="ignore"):
            return [np.asarray(_REDUCTIONS[name](arrays[0], axis=tuple(params["axes"])), out.dtype)]
    if name == "div" and np.dtype(out.dtype).kind in "fc":
        with np.errstate(all="ignore"):
            return [np.asarray(np.divide(*arrays), out.dtype)]
    if name in _UFUNCS and (name not in _LOGICAL or out.dtype == np.bool_):
        with np.errstate(all="ignore"):
            return [np.asarray(_UFUNCS[name](*arrays), out.dtype)]
    value = eqn.primitive.bind(*arrays, **params)
    return [np.asarray(v) for v in (value if eqn.primitive.multiple_results else [value])]
