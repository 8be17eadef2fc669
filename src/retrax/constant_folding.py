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


def evaluate(eqn: Any, arrays: list[np.ndarray]) -> list[np.ndarray]:
    """The values of one equation of a jaxpr."""
    found = by_numpy(eqn, arrays)
    if found is not None:
        return [found]
    value = eqn.primitive.bind(*arrays, **eqn.params)
    return [np.asarray(v) for v in (value if eqn.primitive.multiple_results else [value])]


def by_numpy(eqn: Any, arrays: list[np.ndarray]) -> np.ndarray | None:
    """The value of one equation; None where that is not simple."""
    kind = np.dtype(eqn.outvars[0].aval.dtype)
    with np.errstate(all="ignore"):
        found = _evaluate_by_numpy(eqn.primitive.name, eqn.params, kind, arrays)
    return None if found is None else np.asarray(found, kind)


def reshape(params: dict[str, Any], array: np.ndarray) -> np.ndarray:
    """An array in other sizes, its entries in the order of these axes: columns first where ``order="F"``."""
    axes = params["dimensions"]
    return (array if axes is None else np.transpose(array, axes)).reshape(params["new_sizes"])


def _evaluate_by_numpy(name: str, params: dict[str, Any], kind: np.dtype, arrays: list[np.ndarray]) -> Any:
    """The value of a primitive, which has this kind; None where that is not simple."""
    if name == "broadcast_in_dim":
        shape = [1] * len(params["shape"])
        for axis, size in zip(params["broadcast_dimensions"], arrays[0].shape, strict=True):
            shape[axis] = size
        return np.broadcast_to(arrays[0].reshape(shape), params["shape"])
    if name == "clamp":
        least, value, most = arrays
        return np.minimum(np.maximum(value, least), most)
    if name == "concatenate":
        return np.concatenate(arrays, params["dimension"])
    if name == "reshape":
        return reshape(params, arrays[0])
    if name == "squeeze":
        return np.squeeze(arrays[0], tuple(params["dimensions"]))
    if name == "iota":
        shape = [1] * len(params["shape"])
        shape[params["dimension"]] = -1
        rows = np.arange(params["shape"][params["dimension"]]).reshape(shape)
        return np.broadcast_to(rows, params["shape"]).astype(kind)
    if name == "convert_element_type" and (kind.kind == "c" or arrays[0].dtype.kind != "c"):
        return arrays[0].astype(kind)
    if name == "integer_pow":
        return arrays[0] ** params["y"] if params["y"] >= 0 else 1 / arrays[0] ** -params["y"]
    if name == "dot_general" and not any(params["dimension_numbers"][1]):  # no axes that both have
        left, right = arrays
        return np.tensordot(left, right, params["dimension_numbers"][0])
    if name == "select_n":
        return np.choose(arrays[0].astype(int), arrays[1:])
    if name == "div" and kind.kind in "fc":
        return np.divide(*arrays)
    if name in _LOGICAL and kind != np.bool_:
        return None
    if name in _REDUCTIONS and arrays[0].size:
        return _REDUCTIONS[name](arrays[0], axis=tuple(params["axes"]))
    return _UFUNCS[name](*arrays) if name in _UFUNCS else None
