"""Mistakes of newcomers: each ends in a sentence that says what to try, in a traceback of at most eight lines."""

import linecache
import os
import re
import subprocess
import sys
import traceback

import pytest
from retrax.integrators.reporting.text import LONGEST_VALUE, brief
from retrax.manifolds import ConvergenceError

MOST_LINES = 8
SETTING = """
import math
import casadi as ca
import jax
import jax.numpy as jnp
import numpy as np
from retrax import SO, Cayley, Euclidean, Gauss, Guess, Midpoint, OptimalControlProblem, Phase
from retrax import hat, integrate, solve, solve_phases
from retrax.integrators import SymplecticIntegrator
from scipy.spatial.transform import Rotation

J = jnp.array([1.0, 2.0, 3.0])
Q = SO(3) * Euclidean(3)
START, END = (np.eye(3), np.zeros(3)), (Rotation.from_rotvec([0.4, 0.2, -0.3]).as_matrix(), np.zeros(3))
LINE, PLANE = Euclidean(1), Euclidean(2)


def dynamics(q, u):
    R, w = q
    return R @ hat(w), (u - jnp.cross(w, J * w)) / J


def effort(q, u):
    return u @ u / 2


def cart(q, u):
    return jnp.stack([q[1], u[0]])


def slew(dynamics=dynamics, effort=effort, controls=3, end=END, horizon=1.0, method=None, steps=3):
    problem = OptimalControlProblem(Q, dynamics, effort, controls)
    return solve(problem, START, end, horizon, method=method or Midpoint(Cayley(Q)), steps=steps)


def move(dynamics=cart, effort=effort, controls=1, start=(0.0, 0.0), end=(1.0, 0.0), max_iterations=100, **o):
    problem = OptimalControlProblem(PLANE, dynamics, effort, controls, **o)
    method = Midpoint(Cayley(PLANE))
    return solve(problem, start, end, 1.0, method=method, steps=3, max_iterations=max_iterations)


LIMITED = OptimalControlProblem(PLANE, cart, effort, 1, control_bounds=(-1.0, 1.0))
IDLE = OptimalControlProblem(PLANE, cart, lambda q, u: (q[1] ** 2 - q[0] ** 2) / 2, 1)


PROBLEM = OptimalControlProblem(Q, dynamics, effort, 3)
METHOD = Midpoint(Cayley(Q))
"""
MISTAKES = {
    # In the user's own functions.
    "numpy in dynamics": ("move(lambda q, u: np.array([q[1], u[0]]))", "jnp"),
    "numpy sin": ("move(lambda q, u: jnp.stack([q[1], np.sin(float(q[0])) + u[0]]))", "jnp.sin instead of np.sin"),
    "math sin": ("move(lambda q, u: jnp.stack([q[1], math.sin(q[0]) + u[0]]))", "jnp.sin"),
    "math sqrt": ("move(effort=lambda q, u: math.sqrt(u @ u))", "jnp"),
    "if": ("move(lambda q, u: jnp.stack([q[1], u[0]]) if q[0] > 0 else jnp.stack([q[1], 2 * u[0]]))", "jnp.where"),
    "and": ("move(effort=lambda q, u: u @ u if q[0] > 0 and q[1] > 0 else 2 * u @ u)", "jnp.where"),
    "while": ("move(effort=lambda q, u: [1 for _ in iter(lambda: bool(q[0] > 0), False)] and u @ u)", "jnp.where"),
    "max": ("move(effort=lambda q, u: max(u[0], 0.0) ** 2)", "jnp.maximum instead of max"),
    "float": ("move(effort=lambda q, u: float(u[0]) ** 2)", "without float"),
    "int index": ("move(lambda q, u: jnp.stack([q[1], [1.0, 2.0][int(q[0])] * u[0]]))", "without int"),
    "item assignment": (
        "def f(q, u):\n    v = jnp.zeros(2)\n    v[0] = q[1]\n    return v\nmove(f)",
        r"jnp.stack\(\[\.\.\.\]\)",
    ),
    "numpy item assignment": (
        "def f(q, u):\n    v = np.zeros(2)\n    v[0] = q[1]\n    return v\nmove(f)",
        r"jnp.stack",
    ),
    "list": ("move(lambda q, u: [q[1], u[0]])", "jax.numpy.array"),
    "tuple": ("move(lambda q, u: (q[1], u[0]))", "jax.numpy.array"),
    "too long": ("move(lambda q, u: jnp.stack([q[1], u[0], u[0]]))", r"shape \(2,\), got \(3,\)"),
    "missing component": ("slew(lambda q, u: q[0] @ hat(q[1]))", "structure"),
    "nothing returned": ("move(lambda q, u: None)", "got"),
    "cost is an array": ("move(effort=lambda q, u: u)", "scalar"),
    "cost is None": ("move(effort=lambda q, u: None)", "number"),
    "three controls read": ("move(lambda q, u: jnp.stack([q[1], u[2]]))", "index|control"),
    "six states read": ("move(lambda q, u: jnp.stack([q[5], u[0]]))", "index|state"),
    "unpacked wrongly": ("slew(lambda q, u: (q[0] @ hat(q[1]), u - q[2]))", "index"),
    "shapes that do not fit": ("move(lambda q, u: jnp.stack([q[1], u[0]]) + jnp.zeros(3))", "shape"),
    "matrix product": ("slew(effort=lambda q, u: u @ jnp.eye(4) @ u)", "shape|dot"),
    "undefined name": ("move(lambda q, u: jnp.stack([q[1], unknown * u[0]]))", "unknown"),
    "attribute of a point": ("move(lambda q, u: jnp.stack([q.speed, u[0]]))", "speed"),
    "division of lists": ("slew(lambda q, u: (q[0] @ hat(q[1]), u / [1.0, 2.0, 3.0]))", "array|operand"),
    "casadi": ("move(lambda q, u: ca.vertcat(q[1], u[0]))", "jax.numpy|JAX|array"),
    "casadi cost": ("move(effort=lambda q, u: ca.sumsqr(u))", "jax.numpy|JAX|number|array"),
    "print format": ("move(effort=lambda q, u: [f'{u[0]:.2f}'] and u @ u)", "jax.numpy|format"),
    "fails by itself": ("def f(q, u):\n    raise RuntimeError('mine')\nmove(f)", "mine"),
    # Arguments of functions.
    "arguments exchanged": ("slew(lambda u, q: dynamics(q, u))", r"its arguments are \(q, u\)"),
    "time first": ("move(lambda t, q, u: cart(q, u))", "time_dependent=True"),
    "time last": ("move(lambda q, u, t: cart(q, u))", "time_dependent=True"),
    "one argument": ("move(lambda q: q)", r"function of \(q, u\)"),
    "no function": ("move(effort=1.0)", r"function of \(q, u\), got 1.0"),
    "end cost of two": ("move(terminal_cost=lambda q, u: q @ q)", "terminal_cost has the arguments"),
    # What makes a problem.
    "wrong number of controls": ("slew(controls=4)", "control"),
    "controls a name": ("slew(controls='u')", "controls must be a Manifold"),
    "bounds reversed": ("move(control_bounds=(1.0, -1.0))", "lower"),
    "bounds a number": ("move(control_bounds=1.0)", r"\(-1.0, 1.0\)"),
    "bounds of three": ("move(control_bounds=(-np.ones(3), np.ones(3)))", "shape"),
    "misspelt keyword": ("move(controls_bounds=(-1.0, 1.0))", "did you mean control_bounds"),
    "umax": ("move(umax=1.0)", "control_bounds"),
    "constraint no dictionary": ("move(constraints=lambda q, u: q[0])", "constraints"),
    "manifold a class": ("OptimalControlProblem(SO, dynamics, effort, 3)", "manifold must be a Manifold"),
    "no cost": ("OptimalControlProblem(Q, dynamics)", "missing a required argument: 'running_cost'"),
    # Ends.
    "quaternion": ("slew(end=(np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3)))", r"shape \(3, 3\)"),
    "reflection": ("slew(end=(np.diag([1.0, 1.0, -1.0]), np.zeros(3)))", "det x"),
    "a Rotation": ("slew(end=(Rotation.identity(), np.zeros(3)))", r"as_matrix\(\)"),
    "angles": ("slew(end=(np.array([0.1, 0.2, 0.3]), np.zeros(3)))", r"shape \(3, 3\)"),
    "end off the manifold": ("slew(end=(1.1 * np.eye(3), np.zeros(3)))", "not on SO"),
    "one factor": ("slew(end=np.eye(3))", "structure"),
    "nan": ("slew(end=(np.nan * np.eye(3), np.zeros(3)))", "NaN"),
    "too many numbers": ("move(end=[1.0, 0.0, 0.0])", r"shape \(2,\), got \(3,\)"),
    "text": ("move(end='there')", "got"),
    # The call.
    "no horizon": ("solve(PROBLEM, START, END)", "'horizon'"),
    "horizon none": ("slew(horizon=None)", "positive finite time"),
    "horizon negative": ("slew(horizon=-1.0)", "positive finite time"),
    "horizon a tuple": ("slew(horizon=(0.0, 1.0))", "positive finite time"),
    "steps a float": ("slew(steps=20.0)", "whole number"),
    "steps positional": ("solve(PROBLEM, START, END, 1.0, 20)", "named, as steps=20"),
    "method a retraction": ("slew(method=Cayley(Q))", r"Midpoint\("),
    "method a name": ("slew(method='gauss')", "discretization map"),
    "method of another manifold": ("slew(method=Midpoint(Cayley(SO(3))))", "acts on"),
    "tf": ("solve(PROBLEM, START, END, tf=1.0)", "missing|no option 'tf'"),
    "guess an array": ("solve(PROBLEM, START, END, 1.0, method=METHOD, steps=3, guess=np.zeros((3, 3)))", "Guess"),
    "guess of other length": (
        "solve(PROBLEM, START, END, 1.0, method=METHOD, steps=3, guess=Guess((np.zeros((5, 3, 3)), np.zeros((5, 3))), "
        "np.zeros((5, 3))))",
        "guess|shape",
    ),
    "parameters that nothing takes": (
        "solve(PROBLEM, START, END, 1.0, steps=3, method=METHOD, parameters=2.0)",
        "param",
    ),
    "tolerance of zero": ("solve(PROBLEM, START, END, 1.0, steps=3, method=METHOD, tolerance=0)", "tolerance"),
    "accuracy in words": ("solve(PROBLEM, START, END, 1.0, accuracy='high')", "accuracy"),
    "accuracy of two": ("solve(PROBLEM, START, END, 1.0, accuracy=2)", "between 0 and 1"),
    "hamiltonian of one": (
        "integrate(lambda q: q @ q, SymplecticIntegrator(Gauss(1, Cayley(LINE))), (J[:1], J[:1]), 0.1, 2)",
        "q, p",
    ),
    "size of a group": ("SO(2.5)", "a whole number n of at least 2, got 2.5"),
    "retraction of a name": ("Cayley('SO(3)')", "takes a manifold, got 'SO"),
    "method of a manifold": ("Midpoint(SO(3))", r"default_retraction\(manifold\)"),
    "stages of a method": ("Gauss(0, Cayley(Q))", "stage"),
    "a phase alone": ("solve_phases(Phase(PROBLEM, METHOD, 3, 1.0))", "phase"),
}


def shown(source: str) -> list[str]:
    """The lines of the traceback that the interpreter shows for a program."""
    name = f"<mistake {abs(hash(source))}>"
    linecache.cache[name] = (len(source), None, source.splitlines(keepends=True), name)
    try:
        exec(compile(source, name, "exec"), dict(SPACE))
    except Exception as error:
        frames = traceback.TracebackException.from_exception(error)
        frames.stack[:] = [frame for frame in frames.stack if frame.filename not in (__file__, "<setting>")]
        return "".join(frames.format()).splitlines()
    return []


SPACE: dict[str, object] = {}


@pytest.fixture(scope="module", autouse=True)
def setting():
    name = "<setting>"
    linecache.cache[name] = (len(SETTING), None, SETTING.splitlines(keepends=True), name)
    exec(compile(SETTING, name, "exec"), SPACE)
    yield
    SPACE.clear()


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_ends_in_a_sentence_on_a_screen(name, monkeypatch):
    monkeypatch.delenv("RETRAX_TRACEBACK", raising=False)
    source, words = MISTAKES[name]
    lines = shown(source)
    assert lines, "nothing is raised"
    assert re.search(words, lines[-1]), "\n".join(lines)
    assert len(lines) <= MOST_LINES


FAILURES = {
    "too few iterations": "move(end=(5.0, 1.0), controls=1, effort=lambda q, u: jnp.cosh(u[0]), max_iterations=1)",
    "an end out of reach": "move(end=(5.0, 0.0), control_bounds=(-1.0, 1.0))",
    "a start outside a limit": "move(start=(2.0, 0.0), constraints={'wall': lambda q, u: q[0] - 1})",
    "phases": "solve_phases([Phase(LIMITED, Midpoint(Cayley(PLANE)), 3, 1.0, start=(0.0, 0.0), end=(9.0, 0.0))])",
    "a singular extremal": "solve(IDLE, (0.0, 0.0), (1.0, 1.0), 1.0, method=Midpoint(Cayley(PLANE)), steps=4)",
}


@pytest.mark.parametrize("name", FAILURES)
@pytest.mark.usual(1)
def test_a_solve_without_success_ends_in_a_sentence_and_a_few_figures(name, monkeypatch):
    """The whole report stays with the error."""
    monkeypatch.delenv("RETRAX_TRACEBACK", raising=False)
    lines = shown(FAILURES[name])
    sentence = next(k for k, line in enumerate(lines) if "ConvergenceError: " in line)
    assert len(lines) <= MOST_LINES
    assert lines[sentence].rstrip().endswith(".")
    assert re.match(r"report  +print\(error.solution\)", lines[-1])
    with pytest.raises(ConvergenceError) as raised:
        exec(FAILURES[name], dict(SPACE))
    assert not raised.value.solution.success
    assert len(str(raised.value.solution).splitlines()) > 8


SCRIPTS = {
    "max": MISTAKES["max"][0],
    "quaternion": MISTAKES["quaternion"][0],
    "an end out of reach": FAILURES["an end out of reach"],
}


@pytest.mark.parametrize("name", SCRIPTS)
@pytest.mark.usual(1)
def test_a_script_ends_on_the_same_lines(name, tmp_path):
    """The interpreter marks the place in each line of a script, on a line more."""
    (tmp_path / "setting.py").write_text(SETTING)
    script = tmp_path / "script.py"
    script.write_text(f"from setting import *\nfound = {SCRIPTS[name]}")
    environment = os.environ | {"JAX_ENABLE_X64": "1", "RETRAX_TRACEBACK": ""}
    run = subprocess.run([sys.executable, script], env=environment, capture_output=True, text=True, check=False)
    lines = re.sub(r'  File ".*setting\.py".*\n(    .*\n)+', "", run.stderr).splitlines()
    assert run.returncode == 1
    assert len(lines) <= MOST_LINES, run.stderr


@pytest.mark.parametrize("length", [1, LONGEST_VALUE, LONGEST_VALUE + 1, 10 * LONGEST_VALUE])
def test_long_values_are_cut_in_messages_and_others_are_whole(length):
    digits = str(10 ** (length - 1))
    assert brief(int(digits)) == (digits if length <= LONGEST_VALUE else f"{digits[:LONGEST_VALUE]}...")
