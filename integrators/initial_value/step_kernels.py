"""Steps of initial-value problems, compiled once on a computer: a step's equations are programs, data to these loops.

All numbers of a lane, one trajectory, are a column of one memory ``v``, shape ``(rows, lanes)``, that programs and
loops read and write; ``places`` has the first row of each of its parts. There is one lane for a single trajectory,
``LANES`` for many.
"""

import numpy as np

from ...kernels import kernel, kernel_part
from ...manifolds.numerics.chord_newton import (
    LARGEST_CURVATURE,
    MAX_CHORDS,
    MAX_JACOBIANS,
    PROBE,
    QUADRATIC_POWER,
    SLOW_RATIOS,
    SMALLEST_PART,
    STALLED,
)
from ...manifolds.numerics.tolerances import EPS
from ...tape.machine import LANES, VECTOR
from .inverse_kernels import copy_to_lanes, invert, multiply
from .machine_kernels import Machine, evaluate, places_of
from .step_programs import MEMORY_PLACES

QUADRATIC, SMALLEST = EPS**QUADRATIC_POWER, SMALLEST_PART * EPS
# Chord steps that are counted as spent only beyond this many, on a Jacobian that is kept from step to step.
PATIENCE = 6
PUSH_COST = 3  # chord steps in whose time the image of one direction is computed
ORDERS = 6  # of the differences from step to step by which a prediction is corrected
PREPARE, RESIDUAL, PUSH, END = range(4)
(
    C, H, STATE, FIRST, SIZES, MISSED, DIRECTION, PUSHED, NEW, CONTROL, FINITE,
    SCALED, CHANGE, STEP, LENGTH, TAKEN, CHORDS, GOING, CONVERGED, GOOD, FRESH, COUNT, STATES, CONTROLS,
) = range(len(MEMORY_PLACES))  # fmt: skip

# Plain tuples stand for records, because Numba's files on disk would name their classes, and later versions fail to
# read them: ``programs`` is (machine, codes, operands, values, ranges, sources, targets): what runs the instructions,
# these, where each program begins and ends, and where they read and write; ``known`` is (inverses, spent, differences,
# small, wide): inverse Jacobians, chord steps spent on each, infinite where it is of no use, and by how much solutions
# differed from predictions, with the differences of this from step to step, by blocks of lanes and substeps, lanes
# last; the inverse Jacobian of small steps, or an empty matrix; and programs, memory and registers of as many lanes as
# the columns of one lane's Jacobian need.


@kernel_part()
def _place(places: np.ndarray, v: np.ndarray) -> None:
    """Write the unknowns of all lanes, in their own units, where programs read them."""
    for i in range(places[COUNT]):
        for j in range(v.shape[1]):
            v[places[C] + i, j] = v[places[SCALED] + i, j] * v[places[SIZES] + i, j]


@kernel_part()
def _measure(places: np.ndarray, v: np.ndarray) -> None:
    """The largest entry of the step of every lane, NaN if one is, becomes ``LENGTH``."""
    for j in range(v.shape[1]):
        v[places[LENGTH], j] = 0.0
    for i in range(places[COUNT]):
        for j in range(v.shape[1]):
            size, largest = abs(v[places[CHANGE] + i, j]), v[places[LENGTH], j]
            v[places[LENGTH], j] = largest if size <= largest or largest != largest else size


@kernel_part()
def _judge(places: np.ndarray, v: np.ndarray, n: int, exact: bool) -> bool:
    """Take the step of each lane that goes on, or leave it, and decide whether more are to come; whether there are
    any."""
    more = False
    for j in range(v.shape[1]):
        v[places[TAKEN], j] = 0.0
        if v[places[GOING], j] == 0:
            continue
        step = v[places[LENGTH], j]
        ratio = step / (np.inf if n == 0 else v[places[STEP], j])
        # The rule of numerics.chord_newton, but that near rounding, where steps shrink as they like, another one is
        # cheaper than a Jacobian.
        shrinks = (LARGEST_CURVATURE * step if exact else 1.0) if n == 0 else np.sqrt(ratio) if n == 1 else ratio
        done = step * min(shrinks, 1.0) <= SMALLEST or (step <= QUADRATIC and ratio > STALLED and n > 0)
        going = not done and (n == 0 or ratio < SLOW_RATIOS or step <= QUADRATIC)
        # A step that hardly shrinks is the fault of an old Jacobian, and may lead back.
        v[places[TAKEN], j] = ratio <= STALLED
        v[places[STEP], j], v[places[CHORDS], j] = step, n + 1
        v[places[CONVERGED], j], v[places[GOING], j] = done, going
        more = more or going
    for i in range(places[COUNT]):
        for j in range(v.shape[1]):
            change = v[places[CHANGE] + i, j] if v[places[TAKEN], j] != 0 else 0.0
            v[places[SCALED] + i, j] -= change
    return more


@kernel_part()
def _chords(
    programs: tuple,
    places: np.ndarray,
    v: np.ndarray,
    w: np.ndarray,
    inverse: np.ndarray,
    exact: bool,
) -> None:
    """Steps with one Jacobian for each lane, ``exact`` at the first of them, until they converge or shrink too
    slowly."""
    for n in range(MAX_CHORDS):
        _place(places, v)
        evaluate(programs, RESIDUAL, v, w)
        multiply(inverse, v, (places[MISSED], places[CHANGE], places[SIZES]))
        _measure(places, v)
        if not _judge(places, v, n, exact):
            return


@kernel_part()
def _probe(programs: tuple, places: np.ndarray, v: np.ndarray, w: np.ndarray, inverse: np.ndarray) -> None:
    """Lanes whose steps do not shrink have converged where the step changes as much by the rounding of the unknowns."""
    m, some = places[COUNT], False
    for j in range(v.shape[1]):
        some = some or (v[places[CONVERGED], j] == 0 and np.isfinite(v[places[STEP], j]))
    if not some:
        return
    changed = np.zeros((m, v.shape[1]))
    for pattern in range(4):  # at the unknowns, and beside them
        for i in range(m):
            turn = 1.0 if pattern == 3 else (0.0, 1.0, -1.0)[pattern % 3] * (1.0 - 2.0 * (i % 2))
            for j in range(v.shape[1]):
                unknown = v[places[SCALED] + i, j]
                moved = turn * PROBE * EPS * max(abs(unknown), 1.0)
                v[places[C] + i, j] = (unknown + moved) * v[places[SIZES] + i, j]
        evaluate(programs, RESIDUAL, v, w)
        multiply(inverse, v, (places[MISSED], places[CHANGE], places[SIZES]))
        _measure(places, v)
        for i in range(m):
            for j in range(v.shape[1]):
                if pattern == 0:
                    v[places[DIRECTION] + i, j] = v[places[CHANGE] + i, j]
                changed[i, j] = max(changed[i, j], abs(v[places[CHANGE] + i, j] - v[places[DIRECTION] + i, j]))
    for j in range(v.shape[1]):
        rounding = np.isfinite(v[places[LENGTH], j])
        for i in range(m):
            # Each entry by itself: that of an unknown that is next to nothing changes by any amount.
            rounding = rounding and abs(v[places[DIRECTION] + i, j]) <= PROBE * max(changed[i, j], SMALLEST)
        if rounding:
            v[places[CONVERGED], j] = 1.0


@kernel_part()
def _renew(
    programs: tuple,
    places: np.ndarray,
    v: np.ndarray,
    w: np.ndarray,
    known: tuple,
    block: int,
    k: int,
) -> None:
    """Inverse Jacobians at all lanes: columns are images of directions, all at once for a single lane."""
    m, single = places[COUNT], v.shape[1] == 1
    _place(places, v)
    inverses, _, _, _, wide = known
    own, x, y = wide if single else (programs, v, w)
    lanes = x.shape[1]
    if single:
        for i in range(v.shape[0]):
            for j in range(lanes):
                x[i, j] = v[i, 0]
    for begin in range(0, m, lanes if single else 1):
        for i in range(m):
            for j in range(lanes):
                here = i == (begin + j if single else begin)
                x[places[DIRECTION] + i, j] = 1.0 if here else 0.0
        evaluate(own, PUSH, x, y)
        for j in range(min(lanes, m - begin) if single else lanes):
            lane, column = (0, begin + j) if single else (j, begin)
            for i in range(m):
                inverses[block, k, i, column, lane] = x[places[PUSHED] + i, j]
    invert(inverses[block, k], v[places[SIZES] : places[SIZES] + m])


@kernel_part()
def _begin(places: np.ndarray, v: np.ndarray, fresh: bool, restart: int) -> bool:
    """Choose the lanes that go on, all good lanes if ``fresh``, else the lanes that have not converged; whether there
    are any.

    A lane begins at the prediction if ``restart`` is 2, or if ``restart`` is 1 and the lane was led away.
    """
    m, some = places[COUNT], False
    for j in range(v.shape[1]):
        going = v[places[GOOD], j] != 0 and (fresh or v[places[CONVERGED], j] == 0)
        if going and (restart == 2 or (restart == 1 and not v[places[STEP], j] < 1)):
            for i in range(m):
                v[places[SCALED] + i, j] = v[places[FIRST] + i, j] / v[places[SIZES] + i, j]
        if fresh:
            v[places[CONVERGED], j], v[places[CHORDS], j] = 0.0, 0.0
        for i in range(m):
            going = going and np.isfinite(v[places[SCALED] + i, j])
        v[places[GOING], j] = going
        some = some or going
    return some


@kernel_part()
def _extrapolate(places: np.ndarray, v: np.ndarray, differences: np.ndarray) -> None:
    """Correct the prediction by the errors of earlier predictions, of the order whose first neglected difference is
    least."""
    for j in range(v.shape[1]):
        order, least = 0, np.inf
        for n in range(ORDERS):
            largest = 0.0
            for i in range(places[COUNT]):
                largest = max(largest, abs(differences[n, i, j]) / v[places[SIZES] + i, j])
            if largest < least:
                order, least = n, largest
        for n in range(order):
            for i in range(places[COUNT]):
                v[places[SCALED] + i, j] += differences[n, i, j] / v[places[SIZES] + i, j]


@kernel_part()
def _compare(places: np.ndarray, v: np.ndarray, differences: np.ndarray) -> None:
    """The differences of all orders after a step: how wrong its prediction was, and how that changed."""
    for i in range(places[COUNT]):
        for j in range(v.shape[1]):
            change = v[places[C] + i, j] - v[places[FIRST] + i, j]
            for n in range(ORDERS):
                change, differences[n, i, j] = change - differences[n, i, j], change


@kernel_part()
def _solve_step(
    programs: tuple,
    places: np.ndarray,
    v: np.ndarray,
    w: np.ndarray,
    known: tuple,
    block: int,
    k: int,
) -> None:
    """Solve the equations of a step in all good lanes, with old Jacobians, with Jacobians of small steps, then with new
    Jacobians.

    Old Jacobians are tried only for speed. The remaining two, in this order, are the iteration of
    ``numerics.chord_newton``.
    """
    inverses, spent, differences, small, _ = known
    inverse, fresh, renewed, no = inverses[block, k], True, 0, False
    if np.isfinite(spent[block, k]):
        _begin(places, v, fresh, 2)
        _extrapolate(places, v, differences[block, k])
        fresh = False
        _chords(programs, places, v, w, inverse, no)
    restart = 2
    if small.size > 0 and _begin(places, v, fresh, restart):
        copy_to_lanes(small, inverse)
        _chords(programs, places, v, w, inverse, no)
        spent[block, k], fresh, restart = np.inf, False, 1
    for _ in range(MAX_JACOBIANS):
        if not _begin(places, v, fresh, restart):
            break
        _renew(programs, places, v, w, known, block, k)
        _chords(programs, places, v, w, inverse, not no)
        _probe(programs, places, v, w, inverse)
        fresh, restart, renewed = False, 0, renewed + 1
    _place(places, v)
    _compare(places, v, differences[block, k])
    most = 0.0
    for j in range(v.shape[1]):
        if v[places[GOOD], j] != 0:
            most = max(most, v[places[CHORDS], j])
    spent[block, k] += max(most - PATIENCE, 0.0)
    if renewed > 0:
        spent[block, k] = 0.0 if renewed == 1 else np.inf  # what is solved with difficulty says little of the next step
    elif spent[block, k] > PUSH_COST * places[COUNT]:
        _renew(programs, places, v, w, known, block, k)
        spent[block, k] = 0.0


@kernel_part()
def _step(
    programs: tuple,
    places: np.ndarray,
    v: np.ndarray,
    w: np.ndarray,
    known: tuple,
    parts: np.ndarray,
    h: np.ndarray,
    first: int,
    block: int,
) -> None:
    """One step of all good lanes, its substeps one after the other; the lanes that fail are good no more."""
    lanes = v.shape[1]
    for k in range(parts.size):
        for j in range(lanes):
            v[places[H], j] = h[min(first + j, h.size - 1)] * parts[k]
        evaluate(programs, PREPARE, v, w)
        _solve_step(programs, places, v, w, known, block, k)
        evaluate(programs, END, v, w)
        for j in range(lanes):
            v[places[GOOD], j] = v[places[GOOD], j] * v[places[CONVERGED], j] * (v[places[FINITE], j] != 0)
            for i in range(places[STATES]):
                v[places[STATE] + i, j] = v[places[NEW] + i, j]
            for i in range(places[CONTROLS]):
                v[places[FRESH] + k * places[CONTROLS] + i, j] = v[places[CONTROL] + i, j]


@kernel_part()
def _advance(
    programs: tuple,
    places: np.ndarray,
    v: np.ndarray,
    w: np.ndarray,
    known: tuple,
    parts: np.ndarray,
    h: np.ndarray,
    carry: np.ndarray,
    failed: np.ndarray,
    record: np.ndarray,
    numbers: tuple,
    block: int,
) -> None:
    """Advance a block of lanes by steps; a lane whose step fails stays at its node."""
    begun, count, phase, every = numbers
    lanes, total, states, rows = v.shape[1], carry.shape[1], places[STATES], carry.shape[0]
    first = block * lanes
    for index in range(count):
        moving = False
        for j in range(lanes):
            lane = min(first + j, total - 1)  # what fills the lanes without a trajectory
            v[places[GOOD], j] = failed[lane] < 0 and first + j < total
            moving = moving or v[places[GOOD], j] != 0
            for i in range(states):
                v[places[STATE] + i, j] = carry[i, lane]
        if moving:
            _step(programs, places, v, w, known, parts, h, first, block)
        for j in range(min(lanes, total - first)):
            if v[places[GOOD], j] != 0:
                for i in range(rows):
                    place = places[STATE] + i if i < states else places[FRESH] + i - states
                    carry[i, first + j] = v[place, j]
            elif failed[first + j] < 0:
                failed[first + j] = begun + index
            for i in range(record.shape[1]):
                record[(phase + index) // every, i, first + j] = carry[rows - record.shape[1] + i, first + j]


@kernel()
def integrate(
    machine: Machine,
    codes: np.ndarray,
    operands: np.ndarray,
    values: np.ndarray,
    ranges: np.ndarray,
    reads: np.ndarray,
    writes: np.ndarray,
    places: np.ndarray,
    memory: tuple,
    carry: np.ndarray,
    failed: np.ndarray,
    record: np.ndarray,
    known: tuple,
    parts: np.ndarray,
    h: np.ndarray,
    numbers: tuple,
    blocks: tuple,
) -> None:
    """Integrate trajectories over some steps of ``h``, shape ``(total,)``, from ``carry``, shape ``(rows, total)``, in
    its place.

    ``machine``: its addresses; ``reads``, ``writes``: rows that the programs read, and write; ``memory``: numbers of
    rows, registers and lanes, and whether the programs call machine code; ``failed``: -1 or the step at which a
    trajectory stopped; ``record``, shape ``(nodes, kept, total)``: the last rows of ``carry`` after each block of
    steps; ``known``: arrays ``(inverses, spent, differences, small)``; ``parts``: those of a step that are its
    substeps; ``numbers``: steps done before, steps to do, those done of a block of steps that are kept together, and
    how many these are; ``blocks``: of lanes, the first and the one after the last.
    """
    rows, size, lanes, native = memory
    programs = machine, codes, operands, values, ranges, places_of(reads, lanes), places_of(writes, lanes)
    many = min(LANES, VECTOR * (1 + (places[COUNT] - 1) // VECTOR)) if lanes == 1 else 1
    several = machine, codes, operands, values, ranges, places_of(reads, many), places_of(writes, many)
    inverses, spent, differences, small = known
    wide = several, np.zeros((rows, many)), np.zeros((size, VECTOR if native else many))
    workspace = inverses, spent, differences, small, wide
    v, w = np.zeros((rows, lanes)), np.zeros((size, VECTOR if native else lanes))
    for block in range(blocks[0], blocks[1]):
        _advance(programs, places, v, w, workspace, parts, h, carry, failed, record, numbers, block)
