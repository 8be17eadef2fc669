"""The instructions of the machine, and the unfused instructions of a graph of scalars in CasADi's order."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

import casadi as ca

from ..errors import RetraxError
from .graph import Loop

# Instructions with the names of CasADi's, those that stand for two or more of them; and of loops, a number of the state
# before, where the rounds begin, the next value of a number of the state, and where a round ends.
NAMES = (
    "ADD", "SUB", "MUL", "DIV", "MUL_ADD", "MUL_SUB", "SUB_MUL", "ADD_ADD", "MUL_ADD_ADD", "TWO_MUL", "TWO_MUL_ADD",
    "MUL_SUB_MUL", "THREE_MUL", "THREE_MUL_ADD", "ADD_CONST", "MUL_CONST", "CONST_SUB", "CONST_DIV", "SELECT", "CONST",
    "INPUT", "OUTPUT", "STATE", "LOOP", "NEXT", "REPEAT", "IF_ELSE_ZERO", "POW", "CONSTPOW",
    "LT", "LE", "EQ", "NE", "AND", "OR", "FMOD", "COPYSIGN", "FMIN", "FMAX", "ATAN2", "HYPOT", "NEG", "SQ", "TWICE",
    "SQRT", "INV", "ASSIGN", "NOT", "FLOOR", "CEIL", "FABS", "SIGN", "SIN", "COS", "TAN", "EXP", "LOG", "ASIN", "ACOS",
    "ATAN", "ERF", "SINH", "COSH", "TANH", "ASINH", "ACOSH", "ATANH", "LOG1P", "EXPM1",
)  # fmt: skip
COMMUTATIVE = frozenset({"ADD", "MUL", "EQ", "NE", "AND", "OR"})
TRUTHS = frozenset({"LT", "LE", "EQ", "NE", "AND", "OR", "NOT"})  # what is true or false
OPERANDS = 7  # at most
CODES = {name: code for code, name in enumerate(NAMES)}
END_NAMES = frozenset({"INPUT", "OUTPUT", "CONST"})  # what is read from elsewhere, or given there
_OF_CASADI = {getattr(ca, f"OP_{name}"): name for name in NAMES if hasattr(ca, f"OP_{name}")}


class UnknownInstructionError(RetraxError, ValueError):
    """A graph has an instruction that the machine does not know."""


@dataclass(slots=True)
class Instruction:
    """An instruction whose operands are named by the instructions that make them."""

    name: str
    inputs: list[int]  # their places in a list
    value: float = 0.0  # a constant, the place of an input or output, or how many rounds there are
    uses: int = field(default=0)
    divides: bool = False  # the second operand is an inverse


def lasting(last: dict[int, int], made: dict[int, int], names: Sequence[str]) -> dict[int, int]:
    """The places where values are needed last, among places with these names: what is from before a loop stays until
    its last round.

    ``made``: the places where values are made, but for those that stay anyway.
    """
    begin = 0
    for place, name in enumerate(names):
        if name == "LOOP":
            begin = place
        elif name == "REPEAT":
            last = last | {i: place for i, at in last.items() if made.get(i, place) < begin < at < place}
    return last


def read(inputs: ca.SX, outputs: ca.SX, loops: Sequence[Loop] = ()) -> tuple[list[Instruction], list[list[int]]]:
    """The instructions of a column of scalars as a function of a column of symbols, and their parts, which run one
    after the other."""
    found = list[Instruction]()
    own, looped = _Reader(found), [_LoopReader(found, loop) for loop in loops]
    given = [ca.densify(ca.vertcat(loop.first, loop.given)) for loop in loops]
    function = ca.Function("f", [inputs, *(loop.symbols for loop in loops)], [outputs, *given])

    def input_of(which: int, place: int) -> int:
        return looped[which - 1].state(place) if which else own.number("INPUT", [], place)

    for which, place, made in own.results(function, input_of):
        if which:
            looped[which - 1].given[place] = made
        else:
            found.append(Instruction("OUTPUT", [made], place))
    if not loops:
        return found, [list(range(len(found)))]
    # The turn in which each runs, so many loops before it: behind the last one whose state it needs.
    after = {k: turn for turn, loop in enumerate(looped, 1) for k in loop.states.values()}
    turns: list[list[int]] = [[] for _ in range(len(loops) + 1)]
    for k, instruction in enumerate(found):
        if k not in after:
            after[k] = max((after[i] for i in instruction.inputs), default=0)
            turns[after[k]].append(k)
    parts = turns[:1]
    for loop, turn in zip(looped, turns[1:], strict=True):
        parts += [*loop.parts(), turn]
    return found, parts


class _LoopReader:
    """A loop among instructions.

    ``states``: instructions that are the numbers of its state, by their places, of those that something asks for, be it
    in a round or behind the last one; ``given``: those that make its first state and then what stays the same.
    """

    def __init__(self, found: list[Instruction], loop: Loop) -> None:
        self._found, self._loop = found, loop
        self.states, self.given = dict[int, int](), dict[int, int]()

    def state(self, place: int) -> int:
        """The instruction that is a number of the state."""
        if place not in self.states:
            self.states[place] = self._add("STATE", [])
        return self.states[place]

    def parts(self) -> list[list[int]]:
        """The parts of a loop: the state before the rounds, the begin, a round, the state after the round, the end."""
        found, count, new, done, begin = self._found, self._loop.first.shape[0], dict[int, int](), 0, len(self._found)
        for which, place, made in _Reader(found).results(
            self._loop.body, lambda which, place: self.given[count + place] if which else self.state(place)
        ):
            if which:
                done = made
            else:  # a number that takes the place of another one in the state is copied before that has its own
                new[place] = self._add("ASSIGN", [made]) if found[made].name == "STATE" else made
        for place, k in self.states.items():
            found[k].inputs = [self.given[place]]
        a_round = [k for k in range(begin, len(found)) if found[k].name != "STATE"]
        following = [self._add("NEXT", [new[place], k]) for place, k in self.states.items()]
        begins, ends = self._add("LOOP", [], self._loop.rounds), self._add("REPEAT", [done])
        return [list(self.states.values()), [begins], a_round, following, [ends]]

    def _add(self, name: str, inputs: list[int], value: float = 0.0) -> int:
        self._found.append(Instruction(name, inputs, value))
        return len(self._found) - 1


class _Reader:
    """Adds instructions to a list, each value computed once; divisors are inverted.

    CasADi finds what is computed twice too, in ten times the time of all else here.
    """

    def __init__(self, found: list[Instruction]) -> None:
        self._found = found
        self._known: dict[tuple, int] = {}
        self._truths = set[int]()

    def number(self, name: str, inputs: list[int], value: float = 0.0, divides: bool = False) -> int:
        """The number of a new or an earlier instruction; an instruction without operands has a ``value``."""
        if not inputs:
            key = name, value, math.copysign(1.0, value)  # zeros of both signs are two numbers
        elif name in COMMUTATIVE and inputs[0] > inputs[1]:
            key = name, inputs[1], inputs[0]
        else:
            key = name, *inputs
        new = len(self._found)
        k = self._known.setdefault(key, new)
        if k == new:
            self._found.append(Instruction(name, inputs, value, 0, divides))
            if name in TRUTHS:
                self._truths.add(k)
        return k

    def results(self, function: ca.Function, given: Callable[[int, int], int]) -> Iterator[tuple[int, int, int]]:
        """The instruction of each number of each output, as soon as the instruction is known.

        ``given`` returns the instructions of the inputs.
        """
        made: dict[int, int] = {}
        read, written, code_of = function.instruction_input, function.instruction_output, function.instruction_id
        for k in range(function.n_instructions()):
            name, ins, outs = _OF_CASADI.get(code_of(k)), read(k), written(k)
            if name is None:
                raise UnknownInstructionError(f"instruction {code_of(k)} of CasADi has no counterpart in the machine")
            if name not in END_NAMES:
                operands = [made[i] for i in ins]
                if name == "MUL" and not self._truths.isdisjoint(operands):
                    # Derivatives of a choice are such products, and the branch that is not taken may be NaN; XLA reads
                    # them so too.
                    name, operands = "IF_ELSE_ZERO", sorted(operands, key=lambda i: i not in self._truths)
                divides = name == "DIV" and self._found[operands[1]].name != "CONST"
                if divides:
                    name, operands = "MUL", [operands[0], self.number("INV", operands[1:])]
                made[outs[0]] = self.number(name, operands, 0.0, divides)
            elif name == "OUTPUT":
                yield outs[0], outs[1], made[ins[0]]
            elif name == "CONST":
                made[outs[0]] = self.number(name, [], function.instruction_constant(k))
            else:
                made[outs[0]] = given(ins[0], ins[1])
