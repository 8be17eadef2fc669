"""Programs of tapes as C source: one line for each instruction, for one point."""

import math
import re
import textwrap
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from .instructions import CODES, NAMES
from .program import Program

PIECE = 1000  # instructions of a function: compilers take longer than in proportion to their number
SOURCE_WIDTH = 116  # characters of a line

# Value of each instruction, of its constant v and its operands. Integers become numbers of the type of the operands.
EXPRESSIONS = {
    "ADD": "{0} + {1}",
    "SUB": "{0} - {1}",
    "MUL": "{0} * {1}",
    "DIV": "{0} / {1}",
    "MUL_ADD": "FUSED({0}, {1}, {2})",
    "MUL_SUB": "FUSED({0}, {1}, -{2})",
    "SUB_MUL": "FUSED(-{0}, {1}, {2})",
    "ADD_ADD": "{0} + {1} + {2}",
    "MUL_ADD_ADD": "FUSED({0}, {1}, {2}) + {3}",
    "TWO_MUL": "FUSED({2}, {3}, {0} * {1})",
    "TWO_MUL_ADD": "FUSED({3}, {4}, FUSED({0}, {1}, {2}))",
    "MUL_SUB_MUL": "FUSED({2}, {3}, -({0} * {1}))",
    "THREE_MUL": "FUSED({4}, {5}, FUSED({2}, {3}, {0} * {1}))",
    "THREE_MUL_ADD": "FUSED({5}, {6}, FUSED({3}, {4}, FUSED({0}, {1}, {2})))",
    "ADD_CONST": "{0} + {v}",
    "MUL_CONST": "{0} * {v}",
    "CONST_SUB": "{v} - {0}",
    "CONST_DIV": "{v} / {0}",
    "CONST": "{v}",
    **dict.fromkeys(("STATE", "NEXT", "ASSIGN"), "{0}"),
    "INV": "1 / {0}",
    "NEG": "-{0}",
    "SQ": "{0} * {0}",
    "TWICE": "{0} + {0}",
    "NOT": "{0} != 0 ? 0 : 1",
    "SIGN": "{0} > 0 ? 1 : ({0} < 0 ? -1 : {0})",
    "LT": "{0} < {1} ? 1 : 0",
    "LE": "{0} <= {1} ? 1 : 0",
    "EQ": "{0} == {1} ? 1 : 0",
    "NE": "{0} != {1} ? 1 : 0",
    "AND": "{0} != 0 && {1} != 0 ? 1 : 0",
    "OR": "{0} != 0 || {1} != 0 ? 1 : 0",
    "FMIN": "{0} < {1} || {1} != {1} ? {0} : {1}",
    "FMAX": "{0} > {1} || {1} != {1} ? {0} : {1}",
    "IF_ELSE_ZERO": "{0} != 0 ? {1} : 0",
    "SELECT": "{0} != 0 ? {1} : {2}",
    "CONSTPOW": "pow{f}({0}, {1})",
    **{name: f"{name.lower()}{{f}}({{0}}, {{1}})" for name in ("POW", "FMOD", "COPYSIGN", "ATAN2", "HYPOT")},
    **{name: f"{name.lower()}{{f}}({{0}})" for name in ("SQRT", "FABS", "FLOOR", "CEIL", *NAMES[CODES["SIN"] :])},
}
ALONE = "LOOP", "REPEAT"  # what ends a piece
OPERANDS_OF = {
    **{name: 1 + max((k for k in range(7) if f"{{{k}}}" in text), default=-1) for name, text in EXPRESSIONS.items()},
    "INPUT": 0,
    "OUTPUT": 1,
    "LOOP": 0,
    "REPEAT": 1,
}


class Line(NamedTuple):
    """An instruction of a program with the registers of its result, None if it has none, and of its operands."""

    name: str
    to: int | None
    operands: tuple[int, ...]
    value: float


class Piece(NamedTuple):
    """Lines that run one after the other, or one ``LOOP`` or ``REPEAT``.

    ``given``: registers whose values the lines need from before; ``left``: registers with values of the lines that
    other pieces need.
    """

    lines: list[Line]
    given: list[int]
    left: list[int]


def c_head(*, single: bool = False) -> str:
    """The lines that a file needs once before functions of ``c_function``.

    Compile the file without ``-ffast-math`` and with ``-ffp-contract=off``, the default of gcc with ``-std=c99``. The
    numbers are those of the tape machine, to the last bit if both or neither round ``FUSED`` once.
    """
    f = "f" if single else ""
    return textwrap.dedent(f"""\
        #include <math.h>

        /* x y + z, rounded once where the processor has an instruction for that. */
        #ifdef FP_FAST_FMA{f.upper()}
        #define FUSED(x, y, z) fma{f}(x, y, z)
        #else
        #define FUSED(x, y, z) ((x) * (y) + (z))
        #endif
        """)


def c_function(program: Program, name: str, *, single: bool = False, piece: int = PIECE) -> str:
    """A C99 function ``static void name(const double *restrict in, double *restrict out)`` for one point.

    Parameters
    ----------
    program : Program
        The program of a tape.
    name : str
        The name of the function, an identifier of C.
    single : bool
        Whether numbers are ``float``; pass the same value to ``c_head``.
    piece : int
        The largest number of instructions of one function. A longer program becomes ``name`` and the functions that
        it calls, ``name_0``, ``name_1`` and so on.

    Returns
    -------
    str
        The text, the same for the same arguments. The functions allocate no memory and call nothing but ``math.h``.
        Loops of the program are loops of C.
    """
    real = "float" if single else "double"
    ends, lines = f"const {real} *restrict in, {real} *restrict out", lines_of(program)
    if len(lines) <= piece:
        body = [statement(line, single=single) for line in lines]
        return _function(f"{name}({ends})", real, Piece(lines, [], []), body)
    found, calls = list[str](), [f"{real} w[{program.size}];"]
    for k, own in enumerate(pieces_of(lines, piece)):
        if own.lines[0].name in ALONE:
            calls.append(statement(own.lines[0], "w[{}]", single=single))
            continue
        body = [*(f"r{r} = w[{r}];" for r in own.given), *(statement(line, single=single) for line in own.lines)]
        body += [f"w[{r}] = r{r};" for r in own.left]
        found.append(_function(f"{name}_{k}({ends}, {real} *restrict w)", real, own, body))
        calls.append(f"{name}_{k}(in, out, w);")
    return "\n".join([*found, _function(f"{name}({ends})", real, Piece([], [], []), calls)])


def lines_of(program: Program) -> list[Line]:
    """The instructions of a program."""
    rows = program.codes.tolist(), program.registers.tolist(), program.values.tolist()
    found = []
    for code, (to, *operands), value in zip(*rows, strict=True):
        name = NAMES[code]
        result = None if name in ("OUTPUT", *ALONE) else to
        found.append(Line(name, result, tuple(operands[: OPERANDS_OF[name]]), value))
    return found


def pieces_of(lines: list[Line], most: int) -> list[Piece]:
    """The lines in pieces of at most ``most``; ``LOOP`` and ``REPEAT`` are pieces of their own."""
    cut = list(_chunks(lines, most))
    given, made = (
        [_live_registers(own) for own in cut],
        [{line.to for line in own if line.to is not None} for own in cut],
    )
    needed, left = [set[int]() for _ in range(len(cut) + 1)], [set[int]() for _ in cut]
    for _ in range(2):  # only the second round knows what the end of a loop leaves to its begin
        again = 0
        for k in reversed(range(len(cut))):
            if cut[k][0].name == "REPEAT":
                again = next(i for i in range(k, -1, -1) if cut[i][0].name == "LOOP")
            left[k] = needed[k + 1] | (needed[again] if cut[k][0].name == "REPEAT" else set())
            needed[k] = given[k] | (left[k] - made[k])
    parts = zip(cut, given, made, left, strict=True)
    return [Piece(own, sorted(before), sorted(new & after)) for own, before, new, after in parts]


def _chunks(lines: list[Line], most: int) -> Iterator[list[Line]]:
    own = list[Line]()
    for line in lines:
        if own and (line.name in ALONE or own[0].name in ALONE or len(own) == most):
            yield own
            own = []
        own.append(line)
    if own:
        yield own


def _live_registers(lines: list[Line]) -> set[int]:
    """The registers that lines read before they write them."""
    found, made = set[int](), set[int | None]()
    for line in lines:
        found |= {*line.operands} - made
        made.add(line.to)
    return found


def statement(line: Line, register: str = "r{}", *, single: bool = False) -> str:
    """An instruction in C, with the name of a register that has braces for its number."""
    names = [register.format(r) for r in line.operands]
    if line.name == "OUTPUT":
        return f"out[{int(line.value)}] = {names[0]};"
    if line.name == "LOOP":
        return f"{{ long long left = {int(line.value)}; do {{"
    if line.name == "REPEAT":
        return f"}} while (--left > 0 && {names[0]} == 0); }}"
    return f"{register.format(line.to)} = {value_of(line, names, single)};"


def value_of(line: Line, names: list[str], single: bool) -> str:
    """The value of an instruction that has a result, as an expression in the names of its operands."""
    if line.name == "INPUT":
        return f"in[{int(line.value)}]"
    return EXPRESSIONS[line.name].format(*names, v=_number(line.value, single), f="f" if single else "")


def _number(value: float, single: bool) -> str:
    """The shortest decimal that C reads as this number."""
    if math.isnan(value):
        return "NAN"
    with np.errstate(over="ignore", under="ignore"):
        number = np.float32(value) if single else np.float64(value)
    if np.isinf(number):
        return "INFINITY" if number > 0 else "-INFINITY"
    return f"{number!s}f" if single else str(number)


def _function(head: str, real: str, own: Piece, body: list[str]) -> str:
    """A function with variables for the registers of some lines."""
    read = {*own.left, *(r for line in own.lines for r in line.operands)}
    made = {line.to for line in own.lines if line.to is not None}
    names = ", ".join(f"r{r}" for r in sorted(read | made))
    declared = textwrap.wrap(f"{real} {names};", SOURCE_WIDTH, subsequent_indent=" " * (len(real) + 1)) if names else []
    words = set(re.findall(r"\w+", " ".join(body)))
    idle = [name for name in re.findall(r"\w+(?=[,)])", head) if name not in words]  # compilers warn of them
    idle += [f"r{r}" for r in sorted(made - read)]
    text = [*declared, *body, *(f"(void){name};" for name in idle)]
    return "\n".join([f"static void {head} {{", *(f"    {line}" for line in text), "}", ""])
