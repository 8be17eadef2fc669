"""The compiled core runs tapes: numbers of an interpreter, whatever the lanes, and no layout that leaves its arrays."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from retrax.compute.binding.library import best_instruction_set, library
from retrax.compute.binding.tape_machine import MachineProgram
from retrax.manifolds import InvalidInputError
from retrax.tape import Tape
from retrax.tape.instructions import CODES, NAMES
from retrax.tape.program import Program

from ..tape.functions import SMOOTH, SPECIAL
from .random_programs import ARGUMENTS, HARD, MEANING, assert_same_numbers, interpreted, random_program

PORTABLE, SETS = 0, range(3)
POINTS = np.random.default_rng(1).choice([*HARD, *np.linspace(0.05, 0.95, 40)], (3, 37))


def ends_of(inputs, outputs):
    """Where the numbers of points stand that are rows of two arrays."""
    return tuple(
        part
        for rows in (inputs, outputs)
        for part in (rows.reshape(-1), np.array([(i, rows.shape[1]) for i in range(rows.shape[1])]).reshape(-1, 2))
    )


def checked(program, own=None):
    """A program for the core."""
    arrays = program.codes, program.registers, program.values
    return MachineProgram(*arrays, program.inputs, program.outputs, program.size, own)


def run(program, inputs, own=None, lanes=None):
    """Outputs of a program on the core, shape ``(points, outputs)``."""
    outputs = np.full((len(inputs), program.outputs), 7.0)
    checked(program, own).run(range(len(inputs)), ends_of(inputs, outputs), lanes)
    return outputs


def test_both_lists_of_instructions_are_one():
    names = [library().retrax_tape_instruction_name(code) for code in range(-1, len(NAMES) + 1)]
    assert names == [None, *(name.encode() for name in NAMES), None]
    assert {"INPUT", "LOOP"} == NAMES_WITHOUT_ARGUMENTS


NAMES_WITHOUT_ARGUMENTS = set(NAMES) - set(ARGUMENTS)


@pytest.mark.parametrize("name", [*SMOOTH, *SPECIAL])
@pytest.mark.usual(2)
def test_numbers_are_those_of_an_interpreter_to_the_last_bit(name):
    """Values and second derivatives, where they are no numbers too; products and sums rounded once, or each."""
    function, x = (SMOOTH[name], POINTS) if name in SMOOTH else (SPECIAL[name][0], SPECIAL[name][1][:, None])
    weights = np.arange(1.0, 4.0)
    value = Tape.trace(lambda y: jnp.sum(jnp.sin(weights * function(y))), x[:, 0])
    for tape in (Tape.trace(function, x[:, 0]), value.second_order()):
        expected = [interpreted(tape.program, x.T, fused) for fused in (False, True)]
        for own in range(best_instruction_set() + 1):
            assert_same_numbers(run(tape.program, x.T.copy(), own), expected[own > PORTABLE])


@pytest.mark.parametrize("own", [-1, 7])
def test_instruction_sets_that_the_processor_lacks_are_refused(own):
    with pytest.raises(InvalidInputError, match="this processor has 0 to"):
        checked(random_program(np.random.default_rng(0)), own)


def test_every_instruction_is_what_it_says():
    """The portable machine, against NumPy and libm, on hard numbers; the other ones where nothing is fused."""
    rng = np.random.default_rng(2)
    for name in MEANING.keys() - {"STATE", "NEXT"}:
        count = ARGUMENTS[name]
        x = rng.choice([*HARD, *rng.normal(size=20)], (200, count))
        codes = np.array([*[CODES["INPUT"]] * count, CODES[name], CODES["OUTPUT"]], np.uint8)
        registers = np.zeros((count + 2, 8), np.uint32)
        registers[:count, 0], registers[count, 0], registers[count + 1, 1] = range(count), count, count
        registers[count, 1 : count + 1] = range(count)
        for value in (0.0, -1.5, np.nan):
            program = Program(codes, registers, np.array([*range(count), value, 0.0]), count, 1, count + 1)
            with np.errstate(all="ignore"):
                expected = MEANING[name](value, *x.T)[:, None]
            for own in SETS[: best_instruction_set() + 1] if "MUL_" not in name and "_MUL" not in name else (PORTABLE,):
                assert_same_numbers(run(program, x, own), expected)


@pytest.mark.parametrize("part", range(4))
@pytest.mark.usual(1)
def test_random_programs_give_the_numbers_of_an_interpreter(part):
    """Loops, constants and inputs that are NaN or infinite; groups of four inputs and outputs; any number of points."""
    rng = np.random.default_rng(part)
    for _ in range(100):
        program = random_program(rng)
        count = int(rng.choice([1, 2, 3, 5, 8, 9, 30, 64, 100]))
        x = rng.choice([*HARD, *rng.normal(size=30)], (count, program.inputs))
        lanes = -(-count // 8) * 8
        assert_same_numbers(run(program, x, PORTABLE, lanes), interpreted(program, x))
        for own in range(1, best_instruction_set() + 1):
            assert_same_numbers(run(program, x, own, lanes), interpreted(program, x, fused=True))


def test_lanes_change_nothing():
    """But in a loop that ends where all points of a lane are done."""
    rng = np.random.default_rng(5)
    for _ in range(60):
        program = random_program(rng)
        program = replace(program, values=np.where(program.codes == CODES["LOOP"], 1.0, program.values))
        x = rng.choice([*HARD, *rng.normal(size=30)], (77, program.inputs))
        for own in range(best_instruction_set() + 1):
            expected = run(program, x, own)
            for lanes in (1, 8, 16, 40, 80, 256):
                assert_same_numbers(run(program, x, own, lanes), expected)


@pytest.mark.parametrize("registers", [1, 10, 600, 5000])
def test_lanes_are_vectors_that_fit_the_points_and_the_near_caches(registers):
    program = replace(random_program(np.random.default_rng(6)), size=registers + 40)
    own, most = checked(program), max(64, min(256, 2**14 // (registers + 40)))
    for points in [*range(1, 70), 100, 255, 256, 257, 1000, 4001]:
        lanes, blocks = own.lanes(points), -(-points // most)
        assert lanes % 8 == 0
        assert lanes * blocks - 8 * blocks < points <= lanes * blocks, "as few as serve all points in so many blocks"


def test_a_part_of_the_points_and_places_in_any_order():
    """Only points of the range are written; columns, rows from the last to the first, and gaps."""
    program = random_program(np.random.default_rng(8))
    x = np.random.default_rng(9).normal(size=(20, program.inputs))
    expected = run(program, x)
    columns, found = x.T.copy(), np.full((program.outputs, 23), 7.0)
    sources = np.array([(20 * i + 19, -1) for i in range(program.inputs)])
    targets = np.array([(23 * i + 1, 1) for i in range(program.outputs)])
    ends = columns[:, ::-1].reshape(-1).copy(), sources, found.reshape(-1), targets
    checked(program).run(range(4, 17), ends)
    assert_same_numbers(found[:, 5:18], expected[4:17].T)
    assert (found[:, [*range(5), *range(18, 23)]] == 7.0).all()


def test_four_numbers_that_are_neighbours_at_the_first_point_alone():
    """Their distances to the next point differ: they are not moved together."""
    rng = np.random.default_rng(12)
    program = next(
        p for p in (random_program(rng) for _ in range(99)) if p.registers[0, 2] == p.registers[-p.outputs, 2] == 4
    )
    count = 12
    x = rng.normal(size=(count, program.inputs))
    expected = run(program, x)
    for which in range(4):
        ends = []
        for numbers in (program.inputs, program.outputs):  # number i of point s is at i + s step_i, all apart
            steps = np.full(numbers, 100)
            steps[which] = 10_000
            ends.append(np.stack([np.arange(numbers), steps], axis=1))
        sources, targets = ends
        points = np.arange(count)[:, None]
        read, written = np.zeros(200_000), np.zeros(200_000)
        read[sources[:, 0] + points * sources[:, 1]] = x
        checked(program).run(range(count), (read, sources, written, targets))
        assert_same_numbers(written[targets[:, 0] + points * targets[:, 1]], expected)


def changed(program, k, code=None, register=None, value=None):
    """A program with another instruction k."""
    codes, registers, values = program.codes.copy(), program.registers.copy(), program.values.copy()
    codes[k] = codes[k] if code is None else code
    if register is not None:
        registers[k, register[0]] = register[1]
    values[k] = values[k] if value is None else value
    return replace(program, codes=codes, registers=registers, values=values)


def looped():
    """A program with a loop."""
    rng = np.random.default_rng(10)
    return next(p for p in (random_program(rng) for _ in range(99)) if (p.codes == CODES["LOOP"]).sum() == 1)


def at(program, name):
    return int(np.flatnonzero(program.codes == CODES[name])[0])


def malformed():
    """Programs that C may not see, and what is wrong with them."""
    program = looped()
    begin, end, first, out = (at(program, name) for name in ("LOOP", "REPEAT", "INPUT", "OUTPUT"))
    alone, behind = changed(program, first, register=(2, 0)), begin + 1
    yield "codes", changed(program, 5, code=len(NAMES)), "a code is not in the list"
    yield "result", changed(program, behind, register=(0, program.size)), "not a register"
    yield "argument", changed(program, out, register=(1, program.size)), "not a register"
    yield "argument of REPEAT", changed(program, end, register=(1, 2**32 - 1)), "not a register"
    yield "result on argument", changed(program, end - 1, register=(1, program.registers[end - 1, 0])), "overwrites"
    yield "fewer registers", replace(program, size=program.size // 2), "not a register"
    for value in (-1.0, 0.5, program.inputs, np.nan, np.inf, 1e300):
        yield f"input {value}", changed(alone, first, value=value), "lies outside"
    yield "output", changed(program, out, value=program.outputs), "lies outside"
    yield "four", changed(program, first, register=(2, 3)), "lies outside"
    yield "four that are fewer", changed(program, first + program.inputs - 1, register=(2, 4)), "lies outside"
    yield "four at the end", changed(program, len(program.codes) - 1, register=(2, 4)), "lies outside"
    yield "no rounds", changed(program, begin, value=0.0), "a loop has no beginning"
    yield "NaN rounds", changed(program, begin, value=np.nan), "a loop has no beginning"
    yield "no end", changed(program, end, code=CODES["LOOP"], value=2.0), "a loop has no beginning"
    yield "ends twice", changed(program, begin - 1, code=CODES["REPEAT"], value=1.0), "a loop has no beginning"
    yield "no beginning", changed(program, begin, code=CODES["CONST"]), "a loop has no beginning"
    yield "back to before", changed(program, end, value=begin), "a loop has no beginning"
    yield "forward", changed(program, end, value=end + 5.0), "a loop has no beginning"
    yield "loop in a loop", changed(program, behind, code=CODES["LOOP"], value=2.0), "a loop has no beginning"
    yield "negative size", replace(program, inputs=-1), "lies outside|negative"
    yield "type of codes", replace(program, codes=program.codes.astype(int)), "codes .*expected an array of uint8"
    yield "fewer values", replace(program, values=program.values[:-1]), "values .*expected an array"
    yield "order", replace(program, registers=np.asfortranarray(program.registers)), "operands .*in C order"


@pytest.mark.parametrize(("program", "says"), [pytest.param(p, says, id=name) for name, p, says in malformed()])
def test_malformed_programs_are_refused(program, says):
    with pytest.raises(InvalidInputError, match=says):
        checked(program)


def test_points_outside_of_arrays_are_refused():
    """Through the last place that there is."""
    program = random_program(np.random.default_rng(11))
    own, x, y = checked(program), np.zeros((6, program.inputs)), np.zeros((6, program.outputs))
    inputs, sources, outputs, targets = ends_of(x, y)
    own.run(range(6), (inputs, sources, outputs, targets))
    for last in (7, 2**62):
        with pytest.raises(InvalidInputError, match="lies outside"):
            own.run(range(last), (inputs, sources, outputs, targets))
    far = [(-1, 1), (len(inputs), 0), (0, len(inputs)), (0, -1), (5, 2**62), (5, -(2**63)), (2**62, 2**62)]
    for row in far:
        wrong = sources.copy()
        wrong[-1] = row
        with pytest.raises(InvalidInputError, match="lies outside"):
            own.run(range(6), (inputs, wrong, outputs, targets))
    for ends, says in (
        ((inputs[:-1], sources, outputs, targets), "lies outside"),
        ((inputs, sources, outputs[:-1], targets), "lies outside"),
        ((inputs.astype(np.float32), sources, outputs, targets), "inputs .*float64"),
        ((inputs, sources[:-1], outputs, targets), "places of inputs"),
        ((inputs, sources, outputs[::2], targets), "outputs .*C order"),
        ((inputs, sources, np.broadcast_to(0.0, outputs.shape), targets), "outputs .*writable"),
    ):
        with pytest.raises(InvalidInputError, match=says):
            own.run(range(6), ends)
    with pytest.raises(InvalidInputError, match="negative"):
        own.run(range(-1, 3), (inputs, sources, outputs, targets))
    for lanes in (0, -8, 12, 2):
        with pytest.raises(InvalidInputError, match="neither 1 nor a positive multiple of 8"):
            own.run(range(6), (inputs, sources, outputs, targets), lanes)
