"""From a graph of scalars to a list of instructions for the machine: fused, and with registers of its own."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np

from ..compute.binding.tape_machine import MachineProgram
from .graph import Loop
from .instructions import CODES, OPERANDS, Instruction, lasting, read

FOUR = 4  # inputs or outputs that stand together: the machine reads and writes as many at once
SUMMANDS = {"ADD": (0, 1), "MUL_ADD": (2,), "MUL_SUB": (2,)}  # the operands of sums that may be sums themselves
FUSED_SUMS = {
    ("ADD", "ADD"): "ADD_ADD",
    ("ADD", "MUL_ADD"): "MUL_ADD_ADD",
    ("ADD", "TWO_MUL"): "TWO_MUL_ADD",
    ("ADD", "THREE_MUL"): "THREE_MUL_ADD",
    ("MUL_ADD", "MUL"): "TWO_MUL",
    ("MUL_ADD", "MUL_ADD"): "TWO_MUL_ADD",
    ("MUL_ADD", "TWO_MUL"): "THREE_MUL",
    ("MUL_ADD", "TWO_MUL_ADD"): "THREE_MUL_ADD",
    ("MUL_SUB", "MUL"): "MUL_SUB_MUL",
}
WINDOW = 500  # instructions among which those that are the same come together, with few registers more
FEW_DIVISIONS = 2  # divisions by one number that are not worth its inverse
ALWAYS = frozenset({"OUTPUT", "LOOP", "NEXT", "REPEAT"})  # what nothing has to use
USUAL = 5  # rounds of a loop


@dataclass(frozen=True, eq=False)
class Program:
    """Instructions ``(code, destination, operands)`` over registers, and how many inputs, outputs and registers they
    use."""

    codes: np.ndarray
    registers: np.ndarray  # destination and operands, shape (instructions, 1 + OPERANDS)
    values: np.ndarray
    inputs: int
    outputs: int
    size: int  # registers

    def on_core(self, instruction_set: int | None = None) -> MachineProgram:
        """The program for the compiled core, on the processor's best instruction set or a lesser one."""
        return MachineProgram(
            self.codes, self.registers, self.values, self.inputs, self.outputs, self.size, instruction_set
        )

    @cached_property
    def work(self) -> int:
        """Number of instructions that usually run."""
        ends = np.flatnonzero(self.codes == CODES["REPEAT"])
        return len(self.codes) + (USUAL - 1) * int(np.sum(ends - self.values[ends]))


def assemble(inputs: ca.SX, outputs: ca.SX, loops: Sequence[Loop] = (), *, window: int | None = WINDOW) -> Program:
    """The program of a column of scalars as a function of a column of symbols.

    ``loops``: those whose symbols the scalars have, in the order in which they run. ``window``: among so many
    instructions, or among all, the same ones stand together: that takes more registers, and less time, as a processor
    foresees which comes next.
    """
    instructions, parts = read(inputs, ca.densify(outputs), loops)
    _count(instructions)
    cut = _rounded_instructions(instructions)
    for k, instruction in enumerate(instructions):
        if instruction.name in ("ADD", "SUB"):
            _select(instructions, instruction)
            _immediate(instructions, instruction)
            _fuse_product(instructions, instruction)
            _fuse_sum(instructions, instruction)
        elif instruction.name in ("MUL", "DIV"):
            _divide(instructions, instruction, FEW_DIVISIONS if k not in cut else np.inf)
            _immediate(instructions, instruction)
    order = list[int]()
    for part in parts:
        kept = [k for k in part if instructions[k].uses or instructions[k].name in ALWAYS]
        size = len(kept) if window is None else window
        order += [k for i in range(0, len(kept), size or 1) for k in _group(instructions, kept[i : i + size])]
    order = order if window is None else _in_fours(instructions, order)
    return _allocate(instructions, order, inputs.shape[0], outputs.shape[0])


def _group(instructions: list[Instruction], kept: list[int]) -> list[int]:
    """An order of some instructions in which many equal instructions follow each other.

    The next kind is the kind of which most instructions can run. Results of other instructions are there.
    """
    waits: dict[int, int] = {}
    users: dict[int, list[int]] = {k: [] for k in kept}
    ready: dict[str, list[int]] = {}
    for k in kept:
        needs = users.keys() & instructions[k].inputs
        waits[k] = len(needs)
        for i in needs:
            users[i].append(k)
        if not needs:
            ready.setdefault(instructions[k].name, []).append(k)
    order: list[int] = []
    while ready:
        name = max(ready, key=lambda name: len(ready[name]))
        group = ready[name]
        for k in group:  # it grows
            for user in users[k]:
                waits[user] -= 1
                if not waits[user]:
                    ready.setdefault(instructions[user].name, []).append(user)
        order += group
        del ready[name]
    return order


def _in_fours(instructions: list[Instruction], kept: list[int]) -> list[int]:
    """An order in which four inputs are read where the first of them is needed, and four outputs are written where the
    last is known."""
    ends: dict[str, dict[int, list[int]]] = {"INPUT": {}, "OUTPUT": {}}
    for k in kept:
        if instructions[k].name in ends:
            ends[instructions[k].name].setdefault(int(instructions[k].value) // FOUR, []).append(k)
    order: list[int] = []
    for k in kept:
        name, four = instructions[k].name, int(instructions[k].value) // FOUR if instructions[k].name in ends else 0
        group = ends[name][four] if name in ends else [k]
        if k == group[-1 if name == "OUTPUT" else 0]:
            order += sorted(group, key=lambda i: instructions[i].value) if name in ends else group
    return order


def _count(instructions: list[Instruction]) -> None:
    for instruction in instructions:
        for k in instruction.inputs:
            instructions[k].uses += 1


def _replace(
    instructions: list[Instruction], instruction: Instruction, name: str, inputs: list[int], value: float
) -> None:
    """Give an instruction other operands; what it no longer needs is released, down to what that needed."""
    for k in inputs:
        instructions[k].uses += 1
    old, instruction.inputs = instruction.inputs, inputs
    instruction.name, instruction.value = name, value
    while old:
        unused = instructions[old.pop()]
        unused.uses -= 1
        if not unused.uses:
            old += unused.inputs


def _rounded_instructions(instructions: list[Instruction]) -> set[int]:
    """The instructions that ``FLOOR`` and ``CEIL`` round to a whole number, whose own rounding may change the
    result."""
    found = set[int]()
    for instruction in instructions:
        if instruction.name in ("FLOOR", "CEIL"):
            (k,) = instruction.inputs
            while instructions[k].name in ("FABS", "NEG"):
                (k,) = instructions[k].inputs
            found.add(k)
    return found


def _divide(instructions: list[Instruction], instruction: Instruction, few: float) -> None:
    """A product with an inverse that at most ``few`` need is a division, which rounds once."""
    if instruction.divides:
        left, inverse = instruction.inputs
        if instructions[inverse].uses <= few:
            _replace(instructions, instruction, "DIV", [left, instructions[inverse].inputs[0]], 0.0)


def _select(instructions: list[Instruction], instruction: Instruction) -> None:
    """``(c ? a : 0) + (not c ? b : 0)`` is one choice."""
    if instruction.name != "ADD":
        return
    first, second = (instructions[k] for k in instruction.inputs)
    if first.name != "IF_ELSE_ZERO" or second.name != "IF_ELSE_ZERO":
        return
    opposite = instructions[second.inputs[0]]
    if opposite.name == "NOT" and opposite.inputs[0] == first.inputs[0]:
        _replace(instructions, instruction, "SELECT", [first.inputs[0], first.inputs[1], second.inputs[1]], 0.0)


def _immediate(instructions: list[Instruction], instruction: Instruction) -> None:
    """A constant operand becomes part of the instruction."""
    if instruction.name not in ("ADD", "SUB", "MUL", "DIV"):
        return
    left, right = (instructions[k] for k in instruction.inputs)
    if left.name == "CONST":
        name = {"ADD": "ADD_CONST", "MUL": "MUL_CONST", "SUB": "CONST_SUB", "DIV": "CONST_DIV"}[instruction.name]
        _replace(instructions, instruction, name, [instruction.inputs[1]], left.value)
    elif right.name == "CONST" and instruction.name != "DIV":
        name = "MUL_CONST" if instruction.name == "MUL" else "ADD_CONST"
        value = -right.value if instruction.name == "SUB" else right.value
        _replace(instructions, instruction, name, [instruction.inputs[0]], value)


def _fuse_product(instructions: list[Instruction], instruction: Instruction) -> None:
    """A product that only this sum needs is formed in it."""
    if instruction.name not in ("ADD", "SUB"):
        return
    for place, other in ((0, 1), (1, 0)):
        product = instructions[instruction.inputs[place]]
        if product.name == "MUL" and product.uses == 1:
            name = "MUL_ADD" if instruction.name == "ADD" else ("MUL_SUB" if place == 0 else "SUB_MUL")
            _replace(instructions, instruction, name, [*product.inputs, instruction.inputs[other]], 0.0)
            return


def _fuse_sum(instructions: list[Instruction], instruction: Instruction) -> None:
    """A sum that only this one needs is formed in it."""
    for place in SUMMANDS.get(instruction.name, ()):
        inner = instructions[instruction.inputs[place]]
        name = FUSED_SUMS.get((instruction.name, inner.name))
        if name is not None and inner.uses == 1:
            rest = [i for other, i in enumerate(instruction.inputs) if other != place]
            at = 2 if instruction.name == "ADD" else len(inner.inputs)
            _replace(instructions, instruction, name, [*inner.inputs[:at], *rest, *inner.inputs[at:]], 0.0)
            return


def _first_of_four(instructions: list[Instruction], ahead: list[int]) -> bool:
    """Whether these are four inputs, or outputs, one after the other."""
    first = instructions[ahead[0]]
    expected = [(first.name, first.value + i) for i in range(FOUR)]
    return [(instructions[k].name, instructions[k].value) for k in ahead] == expected


def _allocate(instructions: list[Instruction], kept: list[int], inputs: int, outputs: int) -> Program:
    """Registers for the values, first the register that was freed last; never an operand's, so that loops are
    vectors."""
    ends = _ends(instructions, kept)
    where: dict[int, int] = {}
    free: list[int] = []
    size = begin = 0
    codes, values = np.zeros(len(kept), np.uint8), np.zeros(len(kept))
    rows: list[tuple[int, ...]] = []  # destination and operands
    for row, k in enumerate(kept):
        instruction = instructions[k]
        operands = [where[i] for i in instruction.inputs]
        codes[row], values[row] = CODES[instruction.name], instruction.value
        to = 0
        if instruction.name == "NEXT":
            operands, to = operands[:1], operands[1]
        elif instruction.name == "LOOP":
            begin = row + 1
        elif instruction.name == "REPEAT":
            values[row] = begin
        elif instruction.name != "OUTPUT":
            to = where[k] = free.pop() if free else size
            size += to == size
        if instruction.name in ("INPUT", "OUTPUT"):
            together = FOUR * _first_of_four(instructions, kept[row : row + FOUR])
            operands = [operands[0] if operands else 0, together]
        rows.append((to, *operands, *[0] * (OPERANDS - len(operands))))
        free += [where[i] for i in ends.get(k, ())]
    registers = np.array(rows, np.uint32).reshape(-1, 1 + OPERANDS)
    return Program(codes, registers, values, inputs, outputs, size)


def _ends(instructions: list[Instruction], kept: list[int]) -> dict[int, list[int]]:
    """The values that no later instruction needs, by instruction; values from before a loop stay until its last
    round."""
    last = {i: row for row, k in enumerate(kept) for i in instructions[k].inputs}
    last = lasting(last, {k: row for row, k in enumerate(kept)}, [instructions[k].name for k in kept])
    ends: dict[int, list[int]] = {}
    for i, row in last.items():
        ends.setdefault(kept[row], []).append(i)
    return ends
