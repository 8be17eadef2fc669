"""What the instructions of the machine are that the processor has vector instructions for, in the words of LLVM."""

import inspect
from collections.abc import Callable
from functools import cache
from typing import Any

from llvmlite import ir
from numba.core import cgutils


def _fused(b: Any, x: Any, y: Any, z: Any) -> Any:
    """``x y + z``, rounded once where the processor has an instruction for it."""
    suffix = f"v{x.type.count}f64" if isinstance(x.type, ir.VectorType) else "f64"
    form = ir.FunctionType(x.type, [x.type] * 3)
    return b.call(cgutils.get_or_insert_function(b.module, form, f"llvm.fmuladd.{suffix}"), [x, y, z])


def _chosen(builder: Any, condition: Any, a: Any, b: Any) -> Any:
    """``a`` where ``condition`` is not zero, else ``b``."""
    return builder.select(builder.fcmp_unordered("!=", condition, ir.Constant(condition.type, None)), a, b)


def _truth(relation: str) -> Callable[..., Any]:
    def emit(b: Any, v: Any, x: Any, y: Any) -> Any:
        one, none = (ir.Constant(v.type, value) for value in (_filled(v.type, 1.0), None))
        return b.select(b.fcmp_ordered(relation, x(), y()), one, none)

    return emit


def _filled(kind: Any, value: float) -> Any:
    return [value] * kind.count if isinstance(kind, ir.VectorType) else value


def _of_llvm(name: str) -> Callable[..., Any]:
    def emit(b: Any, v: Any, x: Any) -> Any:
        suffix = f"v{v.type.count}f64" if isinstance(v.type, ir.VectorType) else "f64"
        function = cgutils.get_or_insert_function(b.module, ir.FunctionType(v.type, [v.type]), f"{name}.{suffix}")
        return b.call(function, [x()])

    return emit


# Instructions that are vector instructions of the processor: operands are loaded when they are called, ``v`` is the
# constant.
EMITTED: dict[str, Callable[..., Any]] = {
    "MUL": lambda b, v, x, y: b.fmul(x(), y()),
    "MUL_ADD": lambda b, v, x, y, z: _fused(b, x(), y(), z()),
    "MUL_SUB": lambda b, v, x, y, z: _fused(b, x(), y(), b.fneg(z())),
    "SUB_MUL": lambda b, v, x, y, z: _fused(b, b.fneg(x()), y(), z()),
    "ADD_ADD": lambda b, v, x, y, z: b.fadd(b.fadd(x(), y()), z()),
    "MUL_ADD_ADD": lambda b, v, x, y, z, t: b.fadd(_fused(b, x(), y(), z()), t()),
    "TWO_MUL": lambda b, v, x, y, z, t: _fused(b, z(), t(), b.fmul(x(), y())),
    "TWO_MUL_ADD": lambda b, v, x, y, s, z, t: _fused(b, z(), t(), _fused(b, x(), y(), s())),
    "MUL_SUB_MUL": lambda b, v, x, y, z, t: _fused(b, z(), t(), b.fneg(b.fmul(x(), y()))),
    "THREE_MUL": lambda b, v, x, y, z, t, q, r: _fused(b, q(), r(), _fused(b, z(), t(), b.fmul(x(), y()))),
    "THREE_MUL_ADD": lambda b, v, x, y, s, z, t, q, r: _fused(
        b, q(), r(), _fused(b, z(), t(), _fused(b, x(), y(), s()))
    ),
    "ADD": lambda b, v, x, y: b.fadd(x(), y()),
    "SUB": lambda b, v, x, y: b.fsub(x(), y()),
    "DIV": lambda b, v, x, y: b.fdiv(x(), y()),
    "MUL_CONST": lambda b, v, x: b.fmul(x(), v),
    "ADD_CONST": lambda b, v, x: b.fadd(x(), v),
    "CONST_SUB": lambda b, v, x: b.fsub(v, x()),
    "CONST_DIV": lambda b, v, x: b.fdiv(v, x()),
    "CONST": lambda b, v: v,
    "STATE": lambda b, v, x: x(),
    "NEXT": lambda b, v, x: x(),
    "INV": lambda b, v, x: b.fdiv(ir.Constant(v.type, _filled(v.type, 1.0)), x()),
    "NEG": lambda b, v, x: b.fneg(x()),
    "SQ": lambda b, v, x: b.fmul(x(), x()),
    "TWICE": lambda b, v, x: b.fadd(x(), x()),
    "SQRT": _of_llvm("llvm.sqrt"),
    "FABS": _of_llvm("llvm.fabs"),
    "LT": _truth("<"),
    "LE": _truth("<="),
    "NOT": lambda b, v, x: _chosen(b, x(), ir.Constant(v.type, None), ir.Constant(v.type, _filled(v.type, 1.0))),
    "SELECT": lambda b, v, x, y, z: _chosen(b, x(), y(), z()),
    "IF_ELSE_ZERO": lambda b, v, x, y: _chosen(b, x(), y(), ir.Constant(v.type, None)),
}


@cache
def operands_of(emit: Callable[..., Any]) -> int:
    """How many operands an instruction has."""
    return len(inspect.signature(emit).parameters) - 2


def spread(builder: Any, kind: Any, value: Any) -> Any:
    """A vector of the same number."""
    place = ir.IntType(32)
    first = builder.insert_element(ir.Constant(kind, ir.Undefined), value, place(0))
    return builder.shuffle_vector(first, first, ir.Constant(ir.VectorType(place, kind.count), None))
