"""Steps of initial-value problems, compiled once on a computer: a step's equations are programs, data to these loops.

All numbers of a lane, one trajectory, are a column of one memory ``v``, shape ``(rows, lanes)``, that programs and loops read and
write; ``places`` has the first row of each of its parts. There is one lane for a single trajectory, ``LANES`` for many.
"""

import warnings
from collections import namedtuple

import numba
import numpy as np
from numba import types

from ...manifolds.numerics.newton import MAX_CHORDS, MAX_JACOBIANS, SLOW, STALLED
from ...tape.machine import LANES, run, run_one
from .programs import PLACES

_compiled = numba.njit(cache=True, error_model="numpy", nogil=True)

EPS = float(np.finfo(float).eps)
QUADRATIC, SMALLEST = EPS**0.65, EPS / 4  # the limits of manifolds.numerics.newton
PATIENCE = 10  # chord steps that a Jacobian of an earlier step may take before it is renewed for the next one
PREPARE, RESIDUAL, PUSH, END = range(4)
(
    C, H, STATE, FIRST, SIZES, MISSED, DIRECTION, PUSHED, NEW, CONTROL, FINITE,
    SCALED, STEP, RATIO, CHORDS, GOING, CONVERGED, GOOD, FRESH, COUNT, STATES, CONTROLS,
) = range(len(PLACES))  # fmt: skip

# Instructions of all programs, and where each of them begins and ends; the machine is a function called by its address, because
# each loop around it would be compiled with all of it otherwise.
Programs = namedtuple("Programs", "machine codes registers values ranges")
# LU factors of Jacobians with their row exchanges, by lanes and substeps; which are old, by blocks of lanes and substeps; memory
# and registers of LANES lanes in which the columns of one lane's Jacobian are computed.
Factors = namedtuple("Factors", "lu pivots old wide registers")


def _array(kind, axes):
    return types.Array(kind, axes, "C")


_MATRIX, _LIST = _array(types.float64, 2), _array(types.int64, 1)
_PROGRAMS = _LIST, _array(types.uint64, 2), _array(types.float64, 1), _array(types.int64, 2)


@numba.cfunc(types.void(*_PROGRAMS, types.int64, _MATRIX, _MATRIX), cache=True, error_model="numpy")
def evaluate(codes, registers, values, ranges, which, v, w):
    """Run one of the programs on a memory with these registers."""
    a, b = ranges[which, 0], ranges[which, 1]
    if v.shape[1] == 1:
        run_one(codes[a:b], registers[a:b], values[a:b], v.reshape(v.size), w.reshape(w.size))
    else:
        run(codes[a:b], registers[a:b], values[a:b], (v, v), w, a - a, v.shape[1])


@_compiled
def _factorise(a, pivots):
    """LU factors of a matrix with partial pivoting, in its place."""
    n = a.shape[0]
    for k in range(n):
        best = k
        for i in range(k + 1, n):
            if abs(a[i, k]) > abs(a[best, k]):
                best = i
        pivots[k] = best
        if best != k:
            for j in range(n):
                a[k, j], a[best, j] = a[best, j], a[k, j]
        for i in range(k + 1, n):
            factor = a[i, k] / a[k, k]
            a[i, k] = factor
            if factor != 0:
                for j in range(k + 1, n):
                    a[i, j] -= factor * a[k, j]


@_compiled
def _solve(a, pivots, b):
    """The solution of a system with these factors, in the place of its right side."""
    n = a.shape[0]
    for k in range(n):
        other = pivots[k]
        if other != k:
            b[k], b[other] = b[other], b[k]
    for i in range(n):
        for j in range(i):
            b[i] -= a[i, j] * b[j]
    for i in range(n - 1, -1, -1):
        for j in range(i + 1, n):
            b[i] -= a[i, j] * b[j]
        b[i] /= a[i, i]


@_compiled
def _place(places, v):
    """Write the unknowns of all lanes, in their own units, where programs read them."""
    for i in range(places[COUNT]):
        for j in range(v.shape[1]):
            v[places[C] + i, j] = v[places[SCALED] + i, j] * v[places[SIZES] + i, j]


@_compiled
def _chords(programs, places, v, w, lu, pivots, first, k, exact):
    """Steps with one Jacobian for each lane, ``exact`` at the first of them, until they converge or shrink too slowly."""
    m = places[COUNT]
    d = np.empty(m)
    machine, codes, registers, values, ranges = programs
    for n in range(MAX_CHORDS):
        _place(places, v)
        machine(codes, registers, values, ranges, RESIDUAL, v, w)
        more = False
        for j in range(v.shape[1]):
            if v[places[GOING], j] == 0:
                continue
            for i in range(m):
                d[i] = v[places[MISSED] + i, j]
            _solve(lu[first + j, k], pivots[first + j, k], d)
            step = 0.0
            for i in range(m):
                d[i] /= v[places[SIZES] + i, j]
                if not abs(d[i]) <= step and step == step:
                    step = abs(d[i])
            ratio = step / (np.inf if n == 0 else v[places[STEP], j])
            # After a Newton step the error is quadratic in it, after a chord step the ratio tells it; rounding ends both.
            remaining = (step * step if exact else step) if n == 0 else step * min(ratio, 1.0)
            done = remaining <= SMALLEST or (step <= QUADRATIC and ratio > STALLED and n > 0) or step <= 0
            if ratio <= STALLED:  # a step that hardly shrinks is the fault of an old Jacobian, and may lead back
                for i in range(m):
                    v[places[SCALED] + i, j] -= d[i]
            going = not done and (n == 0 or ratio < SLOW)
            v[places[STEP], j], v[places[CHORDS], j] = step, n + 1
            v[places[CONVERGED], j], v[places[GOING], j] = done, going
            more = more or going
        if not more:
            return


@_compiled
def _renew(programs, places, v, w, factors, first, k):
    """Jacobians at all lanes, factorised: columns are images of directions, all at once for a single lane."""
    m, single = places[COUNT], v.shape[1] == 1
    machine, codes, registers, values, ranges = programs
    _place(places, v)
    x, y = (factors.wide, factors.registers) if single else (v, w)
    if single:
        for i in range(v.shape[0]):
            for j in range(LANES):
                x[i, j] = v[i, 0]
    for begin in range(0, m, LANES if single else 1):
        for i in range(m):
            for j in range(LANES):
                here = i == (begin + j if single else begin)
                x[places[DIRECTION] + i, j] = 1.0 if here else 0.0
        machine(codes, registers, values, ranges, PUSH, x, y)
        for j in range(min(LANES, m - begin) if single else LANES):
            lane, column = (first, begin + j) if single else (first + j, begin)
            for i in range(m):
                factors.lu[lane, k, i, column] = x[places[PUSHED] + i, j]
    for j in range(v.shape[1]):
        _factorise(factors.lu[first + j, k], factors.pivots[first + j, k])


@_compiled
def _begin(places, v, tries):
    """Choose the lanes that go on, at first all good ones, then those not converged yet; whether there are any.

    They begin at the prediction, and do so again where an earlier step's Jacobian, the first of the ``tries``, led away.
    """
    m, some = places[COUNT], False
    for j in range(v.shape[1]):
        going = v[places[GOOD], j] != 0 and (tries == 0 or v[places[CONVERGED], j] == 0)
        if tries == 0 or (tries == 1 and going and not v[places[STEP], j] < 1):
            for i in range(m):
                v[places[SCALED] + i, j] = v[places[FIRST] + i, j] / v[places[SIZES] + i, j]
            v[places[CONVERGED], j] = 0.0
        for i in range(m):
            going = going and np.isfinite(v[places[SCALED] + i, j])
        v[places[GOING], j] = going
        some = some or going
    return some


@_compiled
def _solve_step(programs, places, v, w, factors, first, block, k):
    """Solve the equations of a step in all good lanes: with the Jacobians of an earlier step, then with their own."""
    old = factors.old[block, k]
    for tries in range(MAX_JACOBIANS + 1):
        if not _begin(places, v, tries + (tries > 0 and old)):
            break
        if tries == 0 and old:
            continue
        if tries > 0:
            _renew(programs, places, v, w, factors, first, k)
        _chords(programs, places, v, w, factors.lu, factors.pivots, first, k, tries > 0)
        factors.old[block, k] = False
        for j in range(v.shape[1]):
            if v[places[GOOD], j] != 0 and tries == 0 and v[places[CHORDS], j] > PATIENCE:
                factors.old[block, k] = True
    _place(places, v)


@_compiled
def _step(programs, places, v, w, factors, parts, h, first, block):
    """One step of all good lanes, its substeps one after the other; the lanes that fail are good no more."""
    machine, codes, registers, values, ranges = programs
    lanes = v.shape[1]
    for k in range(parts.size):
        for j in range(lanes):
            v[places[H], j] = h[min(first + j, h.size - 1)] * parts[k]
        machine(codes, registers, values, ranges, PREPARE, v, w)
        _solve_step(programs, places, v, w, factors, first, block, k)
        machine(codes, registers, values, ranges, END, v, w)
        for j in range(lanes):
            v[places[GOOD], j] = v[places[GOOD], j] * v[places[CONVERGED], j] * (v[places[FINITE], j] != 0)
            for i in range(places[STATES]):
                v[places[STATE] + i, j] = v[places[NEW] + i, j]
            for i in range(places[CONTROLS]):
                v[places[FRESH] + k * places[CONTROLS] + i, j] = v[places[CONTROL] + i, j]


@_compiled
def _advance(programs, places, v, w, factors, parts, h, carry, failed, record, numbers, block):
    """Steps of a block of lanes, of which those that fail stay where they are."""
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
            _step(programs, places, v, w, factors, parts, h, first, block)
        for j in range(min(lanes, total - first)):
            if v[places[GOOD], j] != 0:
                for i in range(rows):
                    place = places[STATE] + i if i < states else places[FRESH] + i - states
                    carry[i, first + j] = v[place, j]
            elif failed[first + j] < 0:
                failed[first + j] = begun + index
            for i in range(record.shape[1]):
                record[(phase + index) // every, i, first + j] = carry[rows - record.shape[1] + i, first + j]


def _integrate(machine, codes, registers, values, ranges, places, memory, carry, failed, record, factors, parts, h, numbers, blocks):
    """Integrate trajectories over some steps of ``h``, shape ``(total,)``, from ``carry``, shape ``(rows, total)``, in its place.

    ``machine`` is ``evaluate``; ``memory``: numbers of rows, registers and lanes; ``failed``: -1 or the step at which a trajectory
    stopped; ``record``, shape ``(nodes, kept, total)``: the last rows of ``carry`` after each block of steps; ``factors``: arrays
    ``(lu, pivots, old)``; ``parts``: those of a step that are its substeps; ``numbers``: steps done before, steps to do, those
    done of a block of steps that are kept together, and how many these are; ``blocks``: of lanes, the first and the one after the last.
    """
    rows, size, lanes = memory
    programs = Programs(machine, codes, registers, values, ranges)
    wide = LANES if lanes == 1 else 1
    lu, pivots, old = factors
    workspace = Factors(lu, pivots, old, np.zeros((rows, wide)), np.zeros((size, wide)))
    v, w = np.zeros((rows, lanes)), np.zeros((size, lanes))
    for block in range(blocks[0], blocks[1]):
        _advance(programs, places, v, w, workspace, parts, h, carry, failed, record, numbers, block)


_BOOLEANS, _NUMBERS = _array(types.boolean, 2), _array(types.float64, 1)
_FACTORS = types.Tuple((_array(types.float64, 4), _array(types.int64, 3), _BOOLEANS))
_INTEGRATE = types.void(
    types.FunctionType(types.void(*_PROGRAMS, types.int64, _MATRIX, _MATRIX)),
    *(*_PROGRAMS, _LIST, types.UniTuple(types.int64, 3), _MATRIX, _LIST, _array(types.float64, 3)),
    *(_FACTORS, _NUMBERS, _NUMBERS, types.UniTuple(types.int64, 4), types.UniTuple(types.int64, 2)),
)
with warnings.catch_warnings():
    warnings.simplefilter("ignore", numba.NumbaExperimentalFeatureWarning)  # of functions that are arguments
    integrate = numba.njit(_INTEGRATE, cache=True, error_model="numpy", nogil=True)(_integrate)
