"""The equations of a step as programs of scalar instructions, and where in one memory they read and write."""

from collections.abc import Hashable
from typing import Any

import casadi as ca
import jax
import numpy as np

from ...compute.binding.integration import StepFunction, StepMethod
from ...compute.binding.tape_machine import MachineProgram
from ...compute.program_digest import content_key
from ...manifolds import InvalidInputError
from ...manifolds.numerics.ambient import Ambient
from ...tape import Tape
from ...tape.graph import apply_change, symbols_in
from ...tape.instructions import CODES
from ...tape.program import Program, assemble
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


# Parts of the memory of a step, in the order of ``retrax_step_rows``.
MEMORY_PARTS = "c", "h", "state", "first", "sizes", "residual", "new", "control", "finite"


def _on_core(program: Program, read: np.ndarray, written: np.ndarray) -> StepFunction:
    """A program between rows of a memory, without the inputs that it does not need."""
    here, values = program.codes == CODES["INPUT"], program.values.copy()
    used, values[here] = np.unique(values[here].astype(int), return_inverse=True)
    machine_program = MachineProgram(program.codes, program.registers, values, len(used), program.outputs, program.size)
    return StepFunction(machine_program, read[used], written)


MOST_KNOWN = 64  # step methods that are kept, so that memory has a bound
_known: dict[Hashable, StepMethod] = {}  # by digests of what was traced, with all values read then; oldest first


class _Memory:
    """Rows given out one after the other."""

    def __init__(self) -> None:
        self.rows = 0

    def take(self, count: int) -> np.ndarray:
        self.rows += count
        return np.arange(self.rows - count, self.rows)


def step_programs(integrator: Integrator, system: Any, y: Any, q: Ambient, p: Ambient) -> StepMethod:
    """The programs of a step of an integrator with a stage, from examples ``y``, ``q``, ``p`` of unknowns and a state.

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
    key = (*digests, *map(rows, parts.values()))
    if key not in _known:
        before, middle, after = map(Tape.read, calls)
        control = rows(calls[2].zeros()[3])
        found = _lay_out((before, middle, middle.push(0), after), parts, [*chart._fields], control)
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


def _lay_out(tapes: tuple[Tape, ...], parts: dict[str, Any], charts: list[str], controls: int) -> StepMethod:
    """The programs of the four tapes with what they read, arrays by name, and write, in rows of one memory."""
    memory = _Memory()
    at = {name: memory.take(rows(part)) for name, part in parts.items()}
    count, states = at["c"].size, sum(at[name].size for name in "yqp")
    sizes = {"residual": count, "new": states, "control": controls, "finite": 1}
    at |= {name: memory.take(size) for name, size in sizes.items()}
    size = memory.rows
    at |= {"direction": memory.take(count), "pushed": np.arange(count)}
    at |= {"state": at["y"] if at["y"].size else at["q"]}
    reads = [
        "hyqp",
        ["c", "h", "q", "p", *charts],
        ["c", "h", "q", "p", *charts, "direction"],
        ["c", "h", "q", *charts],
    ]
    writes = charts, ["residual"], ["pushed"], ["new", "control", "finite"]
    read, written = ([np.concatenate([at[name] for name in names]) for names in part] for part in (reads, writes))
    functions = _merge(tapes, read, written, always={*at["first"].tolist(), *at["sizes"].tolist()})
    first = tuple(int(at[name][0]) if at[name].size else 0 for name in MEMORY_PARTS)
    return StepMethod(functions, first, count, states, controls, size)


def _merge(
    tapes: tuple[Tape, ...], reads: list[np.ndarray], writes: list[np.ndarray], always: set[int]
) -> tuple[StepFunction, ...]:
    """The programs of tapes that follow each other, between these rows.

    What the first one finds constant, or finds twice, is so in the others; of the rest it writes what these, or the
    core, read.
    """
    values, loops = zip(*(tape.graph.schedule([tape.outputs]) for tape in tapes), strict=True)
    prepared: list[Any] = ca.cse(values[0][0]).elements()
    first_row: dict[int, int] = {}
    again = {row: first_row.setdefault(hash(e), row) for row, e in zip(writes[0].tolist(), prepared, strict=True)}
    constant = {row: e for row, e in zip(writes[0].tolist(), prepared, strict=True) if e.is_constant()}
    functions, needed = list[StepFunction](), set(always)
    for k, (tape, read, write) in enumerate(zip(tapes[1:], reads[1:], writes[1:], strict=True), 1):
        symbols: list[Any] = tape.inputs.elements()
        by_row = dict(zip(read.tolist(), symbols, strict=True))
        simpler = [constant.get(row, by_row[again.get(row, row)]) for row in read.tolist()]
        given = [tape.inputs], [ca.vertcat(*simpler)]
        (value,), own = apply_change(lambda parts, given=given: ca.substitute(parts, *given), values[k], loops[k])
        used = symbols_in([value], own)
        needed |= {row for row, symbol in by_row.items() if hash(symbol) in used}
        functions.append(_on_core(assemble(tape.inputs, value, own, window=None), read, write))
    kept = [k for k, row in enumerate(writes[0].tolist()) if row in needed]
    first = assemble(tapes[0].inputs, ca.vertcat(*(prepared[k] for k in kept)), loops[0], window=None)
    return _on_core(first, reads[0], writes[0][kept]), *functions
