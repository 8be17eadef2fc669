"""Implicit steps by the core, against closed forms and SciPy: one trajectory and lanes of them, failures, pieces."""

import subprocess
import sys
from itertools import pairwise
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest
from retrax.compute.binding import library
from retrax.compute.binding.integration import Integration, StepFunction, StepMethod
from retrax.compute.binding.tape_machine import MachineProgram
from retrax.manifolds import InvalidInputError
from retrax.tape import Tape
from scipy.optimize import root

MATRIX = np.array([[0.0, 1.0, 0.0], [-2.0, -0.1, 0.5], [0.3, 0.0, -0.4]])
COUNTS = [1, 2, 8, 9, 64, 65, 130]


def method_of(slope, size, controls=0):
    """The rule of the midpoint for ``x' = slope(x)``, with the next state as its unknowns and the slope as control."""
    m, U = size, controls
    at = np.cumsum([0, m, 1, m, m, m, m, m, U, 1])
    c, h, s, first, sizes, missed, new, control, usable = (np.arange(a, b) for a, b in pairwise(at))
    behind = np.arange(at[-1], at[-1] + m)

    def residual(c, h, s):
        return c - s - h * slope((c + s) / 2)

    tapes = (
        Tape.trace(lambda h, s: (s, jnp.ones(m)), 0.1, np.zeros(m)),
        tape := Tape.trace(residual, np.zeros(m), 0.1, np.zeros(m)),
        tape.push(0),
        Tape.trace(lambda c, h, s: (c, slope((c + s) / 2)[:U], jnp.all(jnp.isfinite(c))), np.ones(m), 0.1, np.ones(m)),
    )
    rows = (
        ((h, s), (first, sizes)),
        ((c, h, s), (missed,)),
        ((c, h, s, behind), (np.arange(m),)),
        ((c, h, s), (new, control, usable)),
    )
    functions = []
    for tape, (reads, writes) in zip(tapes, rows, strict=True):
        p = tape.program
        own = MachineProgram(p.codes, p.registers, p.values, p.inputs, p.outputs, p.size)
        functions.append(StepFunction(own, np.concatenate(reads), np.concatenate(writes)))
    return StepMethod(tuple(functions), (*at[:7].tolist(), at[7] if U else 0, at[8]), m, m, U, int(at[-1]))


def begun(method, starts, step_sizes, parts=(1.0,), inverse=None):
    """An integration from starts in rows, all of whose rows are recorded."""
    parts = np.array(parts)
    carry = np.concatenate([starts.T, np.zeros((len(parts) * method.controls, len(starts)))])
    return Integration(method, np.ascontiguousarray(carry), step_sizes, parts, inverse, len(carry))


def drawn(count):
    rng = np.random.default_rng(count)
    return rng.normal(size=(count, 3)), rng.uniform(-0.4, 0.4, count)


@pytest.mark.parametrize("count", COUNTS)
@pytest.mark.parametrize("parts", [(1.0,), (1.3, -0.6, 0.3)])
def test_linear_systems_move_by_the_cayley_transform(count, parts):
    """Substeps one after the other, with the control of each; every second node is recorded."""
    starts, sizes = drawn(count)
    found = begun(method_of(lambda x: MATRIX @ x, 3, 2), starts, sizes, parts, np.eye(3) if count % 2 else None)
    record = found.run(0, 24, 0, 2)
    assert record.shape == (12, 3 + 2 * len(parts), count)
    assert (found.failed == -1).all()
    for k in {0, count // 2, count - 1}:
        x = starts[k]
        for node in range(24):
            controls = []
            for part in parts:
                half = sizes[k] * part * MATRIX / 2
                new = np.linalg.solve(np.eye(3) - half, (np.eye(3) + half) @ x)
                controls += [*(MATRIX @ (x + new) / 2)[:2]]
                x = new
            if node % 2:
                np.testing.assert_allclose(record[node // 2, :, k], [*x, *controls], rtol=1e-12, atol=1e-13)


@pytest.mark.parametrize("count", [1, 9])
def test_a_stiff_system_moves_as_scipy_solves_its_equations(count):
    """Steps that neither the inverse of small steps nor an old inverse solves."""

    def slope(x, to=np):
        return to.stack([x[1], 300.0 * (1.0 - x[0] ** 2) * x[1] - x[0], to.sin(40.0 * x[0]) - 50.0 * x[2] ** 3])

    starts = np.random.default_rng(3).uniform(0.5, 1.5, (count, 3))
    sizes = np.geomspace(0.003, 0.03, count)
    found = begun(method_of(lambda x: slope(x, jnp), 3), starts, sizes, inverse=np.eye(3))
    record = found.run(0, 10, 0, 1)
    assert (found.failed == -1).all()
    for k in range(count):
        x = starts[k]
        for node in range(10):
            near = record[node, :, k]
            new = root(lambda c, x=x, k=k: c - x - sizes[k] * slope((c + x) / 2), near, tol=1e-14)
            np.testing.assert_allclose(near, new.x, rtol=1e-10, atol=1e-10)
            x = near


@pytest.mark.parametrize("count", [1, 2, 40, 70])
def test_a_trajectory_ends_where_a_step_has_no_solution_and_others_go_on(count):
    """``x' = x^2 + 1`` by the midpoint: amid ``y = x + h (y^2 + 1) / 2`` has roots where ``1 >= h (2 x + h)``."""
    sizes = np.linspace(0.08, 1.2, count) if count > 1 else np.array([0.45])
    starts, x, ends = np.zeros((count, 1)), np.zeros(count), np.full(count, -1)
    found = begun(method_of(lambda x: x**2 + 1, 1), starts, sizes)
    record = found.run(0, 9, 0, 1)
    for step in range(9):
        left = 1 - sizes * (2 * x + sizes)
        ends = np.where((ends < 0) & (left < 0), step, ends)
        y = (1 - np.sqrt(np.maximum(left, 0.0))) / sizes
        x = np.where(ends < 0, 2 * y - x, x)
        near = left < 1e-3  # where roots meet, rounding decides
        np.testing.assert_allclose(record[step, 0][~near], x[~near], rtol=1e-9)
    np.testing.assert_array_equal(found.failed, ends)
    assert count < 40 or len({*ends}) > 4


@pytest.mark.parametrize("every", [1, 3, 7])
def test_pieces_are_the_steps_of_one(every):
    starts, sizes = drawn(9)
    method = method_of(lambda x: MATRIX @ x - x**3, 3)
    whole, parts = begun(method, starts, sizes), begun(method, starts, sizes)
    expected, done = whole.run(0, 21, 0, every), 0
    found = np.full_like(expected, np.nan)
    for count in (1, 2, 5, 0, 9, 4):
        record = parts.run(done, count, done % every, every)
        found[done // every : done // every + len(record)] = record
        done += count
    np.testing.assert_array_equal(found, expected)


def test_an_infinite_derivative_is_no_solution():
    """Its inverse would be 0, and so the step that is left."""
    method = method_of(lambda x: -1e308 * x**3, 1)
    found = begun(method, np.array([[0.3], [0.0]]), np.array([1.0, 1.0]))
    found.run(0, 1, 0, 1)
    assert found.failed[0] == 0


def test_methods_and_arrays_that_do_not_fit_are_refused():
    method, starts, sizes = method_of(lambda x: MATRIX @ x, 3), *drawn(9)
    prepare, *others = method.functions

    def having(*functions):
        return method._replace(functions=functions)

    wrong = {
        "first rows": method._replace(first=(*method.first[:-1], method.rows)),
        "got the first rows": method._replace(unknowns=0),
        "function 0 of a step has 4 rows": having(prepare._replace(reads=prepare.reads[1:]), *others),
        "from 0 to": having(prepare._replace(writes=prepare.writes + method.rows), *others),
        "function 1": having(prepare, others[0]._replace(reads=others[0].reads - 1), *others[1:]),
    }
    for says, other in wrong.items():
        with pytest.raises(InvalidInputError, match=says):
            begun(other, starts, sizes)
    with pytest.raises(InvalidInputError, match="states of trajectories"):
        begun(method, starts[1:], sizes)
    with pytest.raises(InvalidInputError, match="inverse Jacobian"):
        begun(method, starts, sizes, inverse=np.eye(2))
    with pytest.raises(InvalidInputError, match="0 trajectories"):
        begun(method, starts[:0], sizes[:0])
    for numbers in ((-1, 1, 0, 1), (0, -1, 0, 1), (0, 1, 1, 1), (0, 1, 0, 0)):
        with pytest.raises(InvalidInputError, match="numbers of steps"):
            begun(method, starts, sizes).run(*numbers)


def test_a_library_that_is_missing_broken_or_of_another_version_is_named(monkeypatch, tmp_path):
    with monkeypatch.context() as other:
        other.setattr(library, "HEADER_VERSION", library.HEADER_VERSION + 1)
        with pytest.raises(library.MissingCoreError, match=r"version .* of its interface, expected .*; try"):
            library.library.__wrapped__()
    broken = tmp_path / "_core.so"
    broken.write_text("text")
    monkeypatch.setattr(library, "find_spec", lambda name: SimpleNamespace(origin=str(broken)))
    with pytest.raises(library.MissingCoreError, match=r"cannot be loaded: .*_core.so.*; try: pip install"):
        library.library.__wrapped__()
    monkeypatch.setattr(library, "find_spec", lambda name: None)
    with pytest.raises(library.MissingCoreError, match=r"core of retrax is not installed: .*; try: *pip install"):
        library.library.__wrapped__()


WITHOUT = """
import runpy
import numpy as np
from retrax.compute.binding import library
library.find_spec = lambda name: None
import retrax as rx
line = rx.Euclidean(1)
try:
    rx.solve(rx.OptimalControlProblem(line, lambda q, u: u, lambda q, u: u @ u, 1), [0.0], [1.0], 1.0, steps=2)
except library.MissingCoreError as error:
    print(error)
runpy.run_module("retrax", run_name="__main__")
"""


def test_without_the_library_the_package_is_imported_and_a_solve_names_it():
    command = [sys.executable, "-W", "ignore", "-c", WITHOUT]
    said, *report = subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines()
    assert said.startswith("the compiled core of retrax is not installed")
    assert said.endswith("try: pip install --force-reinstall --no-deps retrax")
    (core,) = [line for line in report if line.startswith("core ")]
    assert "missing: the compiled core" in core
