"""Programs of tapes as C source: numbers of the tape machine to the last bit, without warnings of the compiler."""

import ctypes
import subprocess
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from retrax.tape import Tape
from retrax.tape.c_source import EXPRESSIONS, OPERANDS_OF, c_function, c_head
from retrax.tape.instructions import CODES
from retrax.tape.program import Program

from ..tape.functions import SMOOTH, SPECIAL
from .random_programs import ARGUMENTS, HARD, MEANING, assert_same_numbers, random_program
from .test_tape_machine import POINTS, PORTABLE, run

PARTS = 8
FLAGS = ["-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Werror", "-O1", "-shared", "-fPIC"]


def compiled(folder, programs, single=False, piece=1000, compiler="gcc"):
    """Functions of points, shape ``(points, inputs)``, one for each program, in one library."""
    real = "float" if single else "double"
    text = [c_head(single=single)]
    for k, program in enumerate(programs):
        text.append(c_function(program, f"own{k}", single=single, piece=piece))
        text.append(f"void f{k}(const {real} *in, {real} *out);")
        text.append(f"void f{k}(const {real} *in, {real} *out) {{\n    own{k}(in, out);\n}}\n")
    (folder / "tapes.c").write_text("\n".join(text))
    subprocess.run([compiler, *FLAGS, "tapes.c", "-o", "tapes.so", "-lm"], cwd=folder, check=True)
    library = ctypes.CDLL(str(folder / "tapes.so"))
    kind = np.float32 if single else np.float64

    def function(k, program):
        def at(points):
            points, found = points.astype(kind), np.full((len(points), program.outputs), 7.0, kind)
            for x, y in zip(points, found, strict=True):
                library[f"f{k}"](ctypes.c_void_p(x.ctypes.data), ctypes.c_void_p(y.ctypes.data))
            return found

        return at

    return [function(k, program) for k, program in enumerate(programs)]


def one_by_one(program, points):
    """Outputs of the tape machine, each point being alone: a loop ends where this point is done."""
    return np.concatenate([run(program, x[None], PORTABLE, 8) for x in points])


def test_instructions_are_those_of_the_machine():
    assert OPERANDS_OF == {**ARGUMENTS, "INPUT": 0, "LOOP": 0}


def alone(name, value):
    """A program of one instruction."""
    count = ARGUMENTS[name]
    codes = np.array([*[CODES["INPUT"]] * count, CODES[name], CODES["OUTPUT"]], np.uint8)
    registers = np.zeros((count + 2, 8), np.uint32)
    registers[:count, 0], registers[count, 0], registers[count + 1, 1] = range(count), count, count
    registers[count, 1 : count + 1] = range(count)
    return Program(codes, registers, np.array([*range(count), value, 0.0]), count, 1, count + 1)


def test_each_instruction_at_hard_numbers(tmp_path):
    cases = [(name, value) for name in sorted(EXPRESSIONS) for value in (0.0, -1.5, np.nan, -np.inf, 5e-324, 1 / 3)]
    rng = np.random.default_rng(2)
    for (name, value), found in zip(cases, compiled(tmp_path, [alone(*case) for case in cases]), strict=True):
        x = rng.choice([*HARD, *rng.normal(size=20)], (60, ARGUMENTS[name]))
        with np.errstate(all="ignore"):
            expected = np.broadcast_to(MEANING[name](value, *x.T) if name != "CONST" else value, len(x))
        assert_same_numbers(found(x)[:, 0], expected)


@pytest.mark.parametrize("piece", [1000, 7])
@pytest.mark.usual(1)
def test_random_programs_with_loops(tmp_path, piece):
    rng = np.random.default_rng(piece)
    programs = [random_program(rng) for _ in range(60)]
    for program, found in zip(programs, compiled(tmp_path, programs, piece=piece), strict=True):
        x = rng.choice([*HARD, *rng.normal(size=30)], (20, program.inputs))
        assert_same_numbers(found(x), one_by_one(program, x))


@pytest.mark.parametrize("part", range(PARTS))
@pytest.mark.usual("0")
def test_functions_of_every_primitive_and_their_second_derivatives(tmp_path, part):
    cases = [(f, POINTS.T.copy()) for f in SMOOTH.values()]
    cases += [(f, np.array(x)[None]) for f, x in SPECIAL.values()]
    cases, tapes = cases[part::PARTS], []
    for function, x in cases:
        value = Tape.trace(lambda y, f=function: jnp.sum(jnp.sin(jnp.arange(1.0, 4.0) * f(y))), x[0])
        tapes.append(value.second_order().program)
    for program, (_, x), found in zip(tapes, cases, compiled(tmp_path, tapes), strict=True):
        assert_same_numbers(found(x), one_by_one(program, x))


def test_single_precision(tmp_path):
    """Numbers of the double machine but for rounding, where the function is smooth."""
    tapes = [Tape.trace(f, np.zeros(3)).program for f in [*SMOOTH.values()][::3]]
    x = np.random.default_rng(4).uniform(0.15, 0.85, (50, 3)).astype(np.float32)
    for program, found in zip(tapes, compiled(tmp_path, tapes, single=True), strict=True):
        expected = run(program, x.astype(float), PORTABLE)
        assert found(x).dtype == np.float32
        close = np.isclose(found(x), expected, rtol=3e-5, atol=3e-5)
        assert np.mean(close) > 0.97  # but beside jumps of the function


def test_text_is_the_same_each_time_and_other_for_other_constants():
    program = random_program(np.random.default_rng(3))
    assert c_function(program, "f") == c_function(replace(program, values=program.values.copy()), "f")
    assert c_function(program, "f") != c_function(replace(program, values=program.values + 1.0), "f")
