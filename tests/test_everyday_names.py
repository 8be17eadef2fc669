"""The names of ``import retrax as rx``, the reader of every record, and ``python -m retrax``."""

import subprocess
import sys
from importlib import import_module
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
import retrax as rx
from matplotlib.figure import Figure
from retrax.__main__ import INSTRUCTION_SETS
from retrax.manifolds import InvalidInputError
from retrax.retractions import Gauss

LINE = rx.Euclidean(1)


def problem():
    """The shortest motion on a line."""
    return rx.OptimalControlProblem(LINE, lambda q, u: u, lambda q, u: u @ u / 2, controls=1)


@pytest.fixture(scope="module")
def solver():
    return rx.Solver(problem(), rx.Midpoint(rx.Cayley(LINE)), 3)


@pytest.mark.parametrize("module", ["retrax", "retrax.integrators", "retrax.manifolds", "retrax.retractions"])
def test_a_directory_lists_public_names(module):
    found = import_module(module)
    assert dir(found) == sorted(found.__all__)
    assert all(hasattr(found, name) for name in dir(found))


def test_everyday_names_are_those_of_the_packages():
    homes = rx.integrators, rx.manifolds, rx.retractions
    for name in set(rx.__all__) - {
        "__version__",
        "load",
        "integrators",
        "manifolds",
        "retractions",
        "plotting",
        "problems",
    }:
        home = next(home for home in homes if name in home.__all__)
        assert getattr(rx, name) is getattr(home, name)


def test_load_reads_every_record(tmp_path, solver):
    solution = solver.solve([0.0], [1.0], 1.0)
    solution.save(tmp_path / "one.npz")
    batch = solver.solve_many(np.zeros((2, 1)), np.ones((2, 1)), 1.0)
    batch.save(tmp_path / "batch.npz")
    integrator = rx.integrators.SymplecticIntegrator(Gauss(1, rx.Cayley(LINE)))
    path = rx.integrate(lambda q, p: p @ p / 2, integrator, (jnp.zeros(1), jnp.ones(1)), 0.1, 2)
    path.save(tmp_path / "path.npz")
    assert rx.load(tmp_path / "one.npz").cost == solution.cost
    np.testing.assert_array_equal(rx.load(tmp_path / "batch.npz").cost, batch.cost)
    np.testing.assert_array_equal(rx.load(str(tmp_path / "path.npz")).q, path.q)


def test_load_reads_a_file_once(tmp_path, solver, monkeypatch):
    solver.solve([0.0], [1.0], 1.0).save(tmp_path / "one.npz")
    read, whole = [], Path.read_bytes
    monkeypatch.setattr(Path, "read_bytes", lambda path: (read.append(path), whole(path))[1])
    rx.load(tmp_path / "one.npz")
    assert read == [tmp_path / "one.npz"]


def test_load_refuses_other_files(tmp_path):
    np.savez(tmp_path / "mine.npz", a=np.ones(3))
    with pytest.raises(InvalidInputError, match="has no entry schema; expected a file from the method save"):
        rx.load(tmp_path / "mine.npz")
    (tmp_path / "text.npz").write_text("no archive")
    with pytest.raises(InvalidInputError, match="is not a record of retrax: it is damaged"):
        rx.load(tmp_path / "text.npz")
    with pytest.raises(FileNotFoundError):
        rx.load(tmp_path / "nowhere.npz")


def test_a_solution_has_the_symbols_of_the_field(solver):
    found = solver.solve([0.0], [1.0], 1.0)
    assert found.t is found.times
    assert found.q is found.states
    assert found.p is found.costates
    assert found.u is found.controls
    assert found.message == found.result
    assert found._repr_html_().startswith("<pre>result  ")
    axes = found.plot()
    assert isinstance(axes[0].figure, Figure)


def test_the_module_prints_what_a_report_needs():
    command = [sys.executable, "-m", "retrax"]
    found = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    rows = dict(line.split(maxsplit=1) for line in found.splitlines() if len(line.split(maxsplit=1)) > 1)
    assert rows["retrax"] == rx.__version__
    assert rows["numpy"] == np.__version__
    assert rows["core"] in INSTRUCTION_SETS
    assert {"jax", "Python", "threads", "precision"} <= set(rows)
