"""The equations of a step as programs of scalar instructions, and where in one memory they read and write."""

from collections.abc import Hashable
from dataclasses import replace
from functools import cached_property
from typing import Any, NamedTuple, Self, final

import casadi as ca
import jax
import numpy as np

from ...compute.integration import StepFunction, StepMethod
from ...compute.program_digest import content_key
from ...compute.tape_machine import MachineProgram
from ...manifolds import InvalidInputError
from ...manifolds.numerics.ambient import Ambient
from ...tape import Tape
from ...tape.graph import changed, symbols_in
from ...tape.instructions import CODES
from ...tape.often import Often
from ...tape.program import Program, assembled
from ...tape.trace import flat
from ..stages import Stage
from .integrator import Integrator
from .step import StepEquations, restore


def rows(tree: Any) -> int:
    """Real numbers in a pytree of arrays."""
    return sum(leaf.size * (2 if np.iscomplexobj(leaf) else 1) for leaf in jax.tree.leaves(tree))


def pack(tree: Any) -> np.ndarray:
    """Arrays with the trajectories along their first axis as one: a row for each real number, a column for each
    trajectory."""
    found = []
    for leaf in jax.tree.leaves(tree):
        array = np.asarray(leaf)
        for half in (np.real(array), np.imag(array)) if np.iscomplexobj(array) else (array,):
            found.append(half.reshape(len(array), -1).T)
    return np.concatenate(found) if found else np.zeros((0, 0))


def unpack(array: np.ndarray, like: Any) -> Any:
    """The arrays in the rows of ``array``, shape ``(nodes, rows, trajectories)``: leading axes ``(trajectories,
    nodes)``."""
    leaves, structure = jax.tree.flatten(like)
    found, begin = [], 0
    for leaf in leaves:
        parts = []
        for _ in range(2 if np.iscomplexobj(leaf) else 1):
            part = np.moveaxis(array[:, begin : begin + leaf.size], -1, 0)
            parts.append(np.ascontiguousarray(part).reshape(*part.shape[:2], *leaf.shape))
            begin += leaf.size
        found.append(parts[0] if len(parts) == 1 else parts[0] + 1j * parts[1])
    return jax.tree.unflatten(structure, found)


# Parts of the memory, whose first rows are ``StepPrograms.places``: what programs read and write; what loops keep
# there; sizes.
MEMORY_PLACES = (
    *("c", "h", "state", "first", "sizes", "residual", "direction", "pushed", "new", "control", "finite"),
    *("scaled", "change", "step", "length", "taken", "chords", "going", "converged", "good", "fresh"),
    *("count", "states", "controls"),
)


class InRows(NamedTuple):
    """A program, and the rows of a memory that it reads and writes."""

    program: Program
    read: np.ndarray
    written: np.ndarray

    @classmethod
    def of(cls, program: Program, read: np.ndarray, written: np.ndarray) -> Self:
        """The program without the inputs that it does not need."""
        here, values = program.codes == CODES["INPUT"], program.values.copy()
        used, values[here] = np.unique(values[here].astype(int), return_inverse=True)
        return cls(replace(program, values=values, inputs=len(used)), read[used], written)

    def at(self, first: int, last: int) -> Program:
        """The program with its rows moved behind ``first`` rows that are read and ``last`` rows that are written."""
        p = self.program
        values, registers = p.values.copy(), p.registers.copy()
        for word, whole, table, operand, begin in (
            ("INPUT", "READ", self.read, 1, first), ("OUTPUT", "WRITE", self.written, 0, last)
        ):  # fmt: skip
            here = p.codes == CODES[word]
            registers[here, operand] = table[values[here].astype(int)]  # for ``run_one``
            registers[here, 2] = 0  # none of them stand beside each other
            values[here] += begin
            registers[p.codes == CODES[whole], 2] = begin
        return replace(p, values=values, registers=registers)


@final
class PackedPrograms:
    """Programs in one list, with the ``ranges`` of each, and of the rows that they read and write.

    ``registers``: how many they need; ``native``: whether they call machine code.
    """

    def __init__(self, programs: list[InRows]) -> None:
        self.reads, self.writes = (np.concatenate([getattr(p, k) for p in programs]) for k in ("read", "written"))
        sizes = np.array([[len(p.codes), len(read), len(written)] for p, read, written in programs])
        cuts = np.concatenate([np.zeros((1, 3), int), np.cumsum(sizes, axis=0)])
        placed = [own.at(*first) for own, first in zip(programs, cuts[:, 1:].tolist(), strict=False)]
        self.codes, self.operands, self.values = (
            np.concatenate([getattr(p, name) for p in placed]) for name in ("codes", "registers", "values")
        )
        self.ranges = np.stack([cuts[:-1, 0], cuts[1:, 0]], axis=1)
        self.registers = max(p.size for p in placed)
        self.engines = [p.engine for p in placed]  # these keep machine code alive

    @property
    def native(self) -> bool:
        return self.engines[0] is not None


@final
class StepPrograms(Often):
    """The programs of a step, ``prepare``, ``residual``, ``push`` and ``end``.

    ``places``: the first rows of what is in the memory, and the numbers of unknowns, of numbers in a state, and of
    controls; ``rows``: how many the memory has; ``code``: what the machine runs.
    """

    def __init__(self, programs: list[InRows], places: np.ndarray, rows: int) -> None:
        super().__init__()
        self.places, self.rows, self._programs = places, rows, programs
        self.code = PackedPrograms(programs)

    @property
    def instructions(self) -> int:
        return len(self.code.codes)

    def compile(self) -> None:
        if not self.code.native:
            from ...tape.native import native

            self.code = PackedPrograms([own._replace(program=native(own.program)) for own in self._programs])

    @cached_property
    def method(self) -> StepMethod:
        """The programs on the core."""
        at = dict(zip(MEMORY_PLACES, self.places.tolist(), strict=True))
        functions = tuple(self._on_core(own, k) for k, own in enumerate(self._programs))
        first = tuple(at[name] for name in ("c", "h", "state", "first", "sizes", "residual", "new", "control", "finite"))
        return StepMethod(functions, first, at["count"], at["states"], at["controls"], self.rows)

    def _on_core(self, own, k):
        p, read, written = own
        at = dict(zip(MEMORY_PLACES, self.places.tolist(), strict=True))
        if k == 2:
            d = at["direction"]
            read = np.where((read >= d) & (read < d + at["count"]), read - d + self.rows, read)
            written = written - at["pushed"]
        return StepFunction(MachineProgram(p.codes, p.registers, p.values, p.inputs, p.outputs, p.size), read, written)

    @property
    def unknowns(self) -> int:
        """Number of unknowns of a step."""
        return int(self.places[MEMORY_PLACES.index("count")])


MOST_KNOWN = 64
_known: dict[Hashable, StepPrograms] = {}  # by digests of what was traced, with all values read then; oldest first


class _Memory:
    """Rows given out one after the other."""

    def __init__(self) -> None:
        self.rows = 0

    def take(self, count: int) -> np.ndarray:
        self.rows += count
        return np.arange(self.rows - count, self.rows)


def step_programs(integrator: Integrator, system: Any, y: Any, q: Ambient, p: Ambient, substeps: int) -> StepPrograms:
    """The programs of the steps of an integrator with a stage, from examples ``y``, ``q``, ``p`` of unknowns and a
    state.

    Raises ``NotTraceableError`` where the equations cannot be written as scalar instructions.
    """

    def prepare(h: Any, y: Any, q: Ambient, p: Ambient) -> Any:
        return StepEquations.near(_stage(integrator, system, h), q, p, y).chart

    def residual(c: Any, h: Any, q: Ambient, p: Ambient, chart: Any) -> Any:
        return StepEquations(_stage(integrator, system, h), chart).residual(c, q, p)

    def end(c: Any, h: Any, q: Ambient, chart: Any) -> Any:
        result = StepEquations(_stage(integrator, system, h), chart).result(c, q)
        new = restore(integrator.manifold, result)
        return new.unknowns, new.q, new.p, integrator.control(new.unknowns), result.converged

    h = np.zeros(())
    first = flat(prepare, h, y, q, p)
    chart = first.zeros()
    c = np.zeros(chart.first.shape)
    parts = {"c": c, "h": h, "y": y, "q": q, "p": p, **chart._asdict()}
    calls = first, flat(residual, c, h, q, p, chart), flat(end, c, h, q, chart)
    digests = [content_key(call.jaxpr) for call in calls]
    key = (*digests, substeps, *map(rows, parts.values()))
    if key not in _known:
        before, middle, after = map(Tape.read, calls)
        control = rows(calls[2].zeros()[3])
        found = _lay_out((before, middle, middle.push(0), after), parts, [*chart._fields], control, substeps)
        if None in digests:
            return found
        if len(_known) >= MOST_KNOWN:
            del _known[next(iter(_known))]
        _known[key] = found
    return _known[key]


def _stage(integrator: Integrator, system: Any, h: Any) -> Stage:
    stage = integrator.stage(system, h)
    if stage is None:
        raise InvalidInputError(
            f"the steps of {type(integrator).__name__} are more than the equations of one stage, expected an "
            "integrator with a stage; try XLA"
        )
    return stage


def _lay_out(
    tapes: tuple[Tape, ...], parts: dict[str, Any], charts: list[str], controls: int, substeps: int
) -> StepPrograms:
    """The programs of the four tapes with what they read, arrays by name, and write, in rows of one memory."""
    memory = _Memory()
    at = {name: memory.take(rows(part)) for name, part in parts.items()}
    count, states = at["c"].size, sum(at[name].size for name in "yqp")
    at |= {name: memory.take(count) for name in ("direction", "residual", "pushed", "scaled", "change")}
    at |= {"new": memory.take(states), "control": memory.take(controls), "fresh": memory.take(substeps * controls)}
    at |= {
        name: memory.take(1) for name in ("finite", "step", "length", "taken", "chords", "going", "converged", "good")
    }
    reads = [
        "hyqp",
        ["c", "h", "q", "p", *charts],
        ["c", "h", "q", "p", *charts, "direction"],
        ["c", "h", "q", *charts],
    ]
    writes = charts, ["residual"], ["pushed"], ["new", "control", "finite"]
    read, written = ([np.concatenate([at[name] for name in names]) for names in part] for part in (reads, writes))
    programs = _merge(tapes, read, written, always={*at["first"].tolist(), *at["sizes"].tolist()})
    at |= {"state": at["y"] if at["y"].size else at["q"]}
    counts = {"count": count, "states": states, "controls": controls}
    places = [counts[name] if name in counts else int(at[name][0]) if at[name].size else 0 for name in MEMORY_PLACES]
    return StepPrograms(programs, np.array(places), memory.rows)


def _merge(
    tapes: tuple[Tape, ...], reads: list[np.ndarray], writes: list[np.ndarray], always: set[int]
) -> list[InRows]:
    """The programs of tapes that follow each other, between these rows.

    What the first one finds constant, or finds twice, is so in the others; of the rest it writes what these, or
    kernels, read.
    """
    values, loops = zip(*(tape.graph.scheduled([tape.outputs]) for tape in tapes), strict=True)
    prepared: list[Any] = ca.cse(values[0][0]).elements()
    first_row: dict[int, int] = {}
    again = {row: first_row.setdefault(hash(e), row) for row, e in zip(writes[0].tolist(), prepared, strict=True)}
    constant = {row: e for row, e in zip(writes[0].tolist(), prepared, strict=True) if e.is_constant()}
    programs, needed = [], set(always)
    for k, (tape, read, write) in enumerate(zip(tapes[1:], reads[1:], writes[1:], strict=True), 1):
        symbols: list[Any] = tape.inputs.elements()
        by_row = dict(zip(read.tolist(), symbols, strict=True))
        simpler = [constant.get(row, by_row[again.get(row, row)]) for row in read.tolist()]
        given = [tape.inputs], [ca.vertcat(*simpler)]
        (value,), own = changed(lambda parts, given=given: ca.substitute(parts, *given), values[k], loops[k])
        used = symbols_in([value], own)
        needed |= {row for row, symbol in by_row.items() if hash(symbol) in used}
        programs.append(InRows.of(assembled(tape.inputs, value, own, window=None), read, write))
    kept = [k for k, row in enumerate(writes[0].tolist()) if row in needed]
    first = assembled(tapes[0].inputs, ca.vertcat(*(prepared[k] for k in kept)), loops[0], window=None)
    return [InRows.of(first, reads[0], writes[0][kept]), *programs]
