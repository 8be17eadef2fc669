"""Programs as machine code: straight lines of the processor's instructions, by LLVM.

The machine chooses each instruction and leaves every value in memory. Code does neither: arithmetic takes a half to a
fifth of the time, and some hundred microseconds to write for each instruction, so it is for programs that have shown to
run often. Its numbers are the machine's to the last bit.
"""

import time
from collections.abc import Iterable, Iterator
from itertools import groupby
from typing import Any, NamedTuple

import numpy as np
from llvmlite import binding, ir
from numba.core import config as numba_config
from numba.core.codegen import get_host_cpu_features

from .emitted import EMITTED, operands_of, spread
from .instructions import CODES, NAMES, OPERANDS, lasting
from .program import VECTOR, Program

config: Any = numba_config  # its names are made when it is read
PIECE = 100  # instructions of a function: what LLVM takes grows faster than their number
KIND = f"<{VECTOR} x double>"


class _Line(NamedTuple):
    """An instruction, with the instructions that make its operands."""

    name: str
    inputs: list[int]
    value: float
    state: int | None = None  # the line of the number of a state that this is the next value of

    @property
    def is_code(self) -> bool:
        """Whether it becomes a line of the code; the machine does what is left."""
        return self.name in EMITTED or self.name == "OUTPUT"


class _Piece(NamedTuple):
    """Some instructions: a function of the code, or one that the machine does."""

    number: int
    lines: list[int]
    is_code: bool


def native(program: Program) -> Program:
    """A program for the machine that calls machine code, but for instructions that are functions anyway."""
    lines = _lines(program)
    pieces = list(_pieces(lines))
    rows, size = _rows(program, lines, pieces)
    groups = [[*group] for _, group in groupby(pieces, lambda piece: piece.is_code)]
    engine = _engine("\n".join(_text(lines, groups, rows)))
    found: list[tuple[str, list[int], float]] = [("READ", [0, program.inputs], 0.0)]
    begin = 0
    for group in groups:
        if group[0].is_code:
            found.append(("CODE", [], float(engine.get_function_address(f"from{group[0].number}"))))
            continue
        for k in (piece.lines[0] for piece in group):
            name, value = lines[k].name, lines[k].value
            begin = len(found) + 1 if name == "LOOP" else begin
            places = [rows[k], *(rows[i] for i in lines[k].inputs)]
            found.append((name, places, begin if name == "REPEAT" else value))
    found.append(("WRITE", [program.inputs, program.outputs], 0.0))
    codes = np.array([CODES[name] for name, _, _ in found], np.uint8)
    registers, values = np.zeros((len(codes), 1 + OPERANDS), np.uint32), np.zeros(len(codes))
    for k, (_, places, value) in enumerate(found):
        registers[k, : len(places)], values[k] = places, value
    return Program(codes, registers, values, program.inputs, program.outputs, size, engine)


def _lines(program: Program) -> list[_Line]:
    """The instructions, which name those that make their operands."""
    found, made = [], dict[int, int]()
    for k, (code, (to, *operands), value) in enumerate(
        zip(program.codes.tolist(), program.registers.tolist(), program.values.tolist(), strict=True)
    ):
        name = NAMES[code]
        state = made[to] if name == "NEXT" else None
        found.append(_Line(name, [made[i] for i in operands[: _operands(name)]], value, state))
        if name not in ("OUTPUT", "NEXT", "LOOP", "REPEAT"):
            made[to] = k
    return found


def _operands(name: str) -> int:
    if name in EMITTED:
        return operands_of(EMITTED[name])
    if name in ("INPUT", "LOOP"):
        return 0
    return 1 if name in ("OUTPUT", "REPEAT") or CODES[name] >= CODES["NEG"] else 2


def _pieces(lines: list[_Line]) -> Iterator[_Piece]:
    """The instructions that become functions of their own, and between them those that the machine does."""
    number, piece = 0, list[int]()
    for k, line in enumerate(lines):
        if line.name == "INPUT":
            continue
        if piece and (len(piece) == PIECE or not line.is_code):
            yield _Piece(number, piece, is_code=True)
            number, piece = number + 1, []
        if line.is_code:
            piece.append(k)
        else:
            yield _Piece(number, [k], is_code=False)
            number += 1
    if piece:
        yield _Piece(number, piece, is_code=True)


def _rows(program: Program, lines: list[_Line], pieces: list[_Piece]) -> tuple[dict[int, int], int]:
    """Where inputs, outputs, and values that one piece leaves to others stand, and the number of these rows."""
    piece_of = {k: piece.number for piece in pieces for k in piece.lines}
    last = {i: piece_of[k] for k, line in enumerate(lines) for i in (*line.inputs, line.state) if i is not None}
    last = lasting(last, piece_of, [lines[piece.lines[0]].name for piece in pieces])
    before = {"INPUT": 0, "OUTPUT": program.inputs}
    rows = {k: before[line.name] + int(line.value) for k, line in enumerate(lines) if line.name in before}
    size, free, ends = program.inputs + program.outputs, list[int](), dict[int, list[int]]()
    for number, piece, is_code in pieces:
        for k in piece:
            stays, state = last.get(k, number) > number or not is_code, lines[k].state
            if state is not None:
                rows[k] = rows[state]
            elif stays and k not in rows:
                if not free:
                    free, size = [size], size + 1
                rows[k] = free.pop()
                ends.setdefault(max(last.get(k, number), number), []).append(rows[k])
        free += ends.pop(number, [])
    return rows, size


def _text(lines: list[_Line], groups: list[list[_Piece]], rows: dict[int, int]) -> Iterator[str]:
    """The module in the language of LLVM: a function for each group of pieces that follow each other, by the name of
    the first."""
    yield _words({line.name for line in lines})
    for group in groups:
        if group[0].is_code:
            for piece in group:
                yield _function(piece, lines, rows)
                time.sleep(0)  # others, which may be in a hurry, go on
            calls = [f"call void @piece{piece.number}(ptr %w)" for piece in group]
            yield "\n".join([f"define void @from{group[0].number}(ptr %w) {{", *calls, "ret void", "}"])


def _function(piece: _Piece, lines: list[_Line], rows: dict[int, int]) -> str:
    """A piece as a function of the rows."""
    text = [f"define internal void @piece{piece.number}(ptr noalias %w) noinline nounwind {{"]
    known = set(piece.lines)

    def place(k: int, word: str) -> str:
        text.append(f"%{word}{k} = getelementptr double, ptr %w, i64 {VECTOR * rows[k]}")
        return f"ptr %{word}{k}, align 8"

    for k in piece.lines:
        line = lines[k]
        for i in line.inputs:
            if i not in known:
                text.append(f"%v{i} = load {KIND}, {place(i, 'r')}")
                known.add(i)
        if line.name == "OUTPUT":
            text.append(f"store {KIND} %v{line.inputs[0]}, {place(k, 'o')}")
            continue
        operands = [f"double {_number(line.value)}", *(f"{KIND} %v{i}" for i in line.inputs)]
        text.append(f"%v{k} = call {KIND} @{line.name}({', '.join(operands)})")
        if k in rows:
            text.append(f"store {KIND} %v{k}, {place(k, 'w')}")
    return "\n".join([*text, "ret void", "}"])


def _number(value: float) -> str:
    """A number as LLVM reads it without rounding."""
    return f"0x{np.float64(value).view(np.uint64):016x}"


def _words(names: Iterable[str]) -> str:
    """The instructions that are used, as functions that are pasted where they are called."""
    module = ir.Module()
    module.triple = binding.get_process_triple()
    kind = ir.VectorType(ir.DoubleType(), VECTOR)
    for name in sorted(EMITTED.keys() & names):
        form = ir.FunctionType(kind, [ir.DoubleType(), *[kind] * operands_of(EMITTED[name])])
        function = ir.Function(module, form, name)
        function.linkage = "internal"
        function.attributes.add("alwaysinline")
        builder = ir.IRBuilder(function.append_basic_block())
        constant = spread(builder, kind, function.args[0])
        builder.ret(EMITTED[name](builder, constant, *(lambda a=a: a for a in function.args[1:])))
    return str(module)


def _engine(text: str) -> Any:
    """The machine code of a module, without the module, which takes fifty times the memory; for the processor that
    Numba compiles for."""
    module, rest = binding.parse_assembly(text), binding.parse_assembly("")
    machine = binding.Target.from_triple(module.triple).create_target_machine(
        cpu=config.CPU_NAME or binding.get_host_cpu_name(),
        features=get_host_cpu_features() if config.CPU_FEATURES is None else config.CPU_FEATURES,
        opt=1,
        codemodel="jitdefault",
        jit=True,
    )
    options = binding.create_pipeline_tuning_options(speed_level=0)
    builder = binding.create_pass_builder(machine, options)
    builder.getModulePassManager().run(module, builder)
    found = binding.ObjectFileRef.from_data(machine.emit_object(module))
    module.close()
    rest.triple = binding.get_process_triple()
    engine = binding.create_mcjit_compiler(rest, machine)
    engine.add_object_file(found)
    engine.finalize_object()
    return engine
