"""On the first use in an environment another process compiles a part of the kernels, or, where none can, this one."""

import itertools
import logging
import os
import subprocess
import sys
import time
from types import SimpleNamespace

import pytest
from retrax import kernels
from retrax.errors import CompilingInterrupted
from retrax.integrators import Solver
from retrax.integrators.boundary_value.engine import first_use, pursuit_kernels, pursuit_types
from retrax.integrators.boundary_value.engine.trial import Trial
from retrax.retractions import Cayley, Midpoint

from tests.integrators.engine.test_trial import SLEWS
from tests.integrators.problems import RIGID, SLEW

SOLVE = """
import sys
import jax.numpy as jnp
import numpy as np
from retrax.integrators import OptimalControlProblem, solve
from retrax.integrators.boundary_value.engine import first_use, pursuit_kernels
from retrax.manifolds import Euclidean
from retrax.retractions import Addition, Midpoint

if "{other}" == "fails":
    sys.executable = "{failing}"
if "{other}" == "none":
    first_use.os.cpu_count = lambda: 1
plane = Euclidean(2)
problem = OptimalControlProblem(plane, lambda q, u: jnp.array([q[1], u[0]]), lambda q, u: u @ u / 2, 1)
found = solve(problem, Midpoint(Addition(plane)), np.zeros(2), np.array([1.0, 0.0]), 1.0, steps=8)
stats = pursuit_kernels.pursue.stats
print(sum(stats.cache_hits.values()), sum(stats.cache_misses.values()), repr(found.cost))
"""


@pytest.fixture
def started(monkeypatch):
    """What is started, by its arguments, instead of processes."""
    found, begun = [], []
    monkeypatch.setattr(first_use, "_begun", begun)
    monkeypatch.setattr(first_use, "Popen", lambda arguments, **options: found.append((arguments, options)))
    monkeypatch.setattr(first_use.os, "cpu_count", lambda: 2)
    first_use.begin.cache_clear()
    yield found
    first_use.begin.cache_clear()


@pytest.mark.parametrize("missing", list(itertools.product((False, True), repeat=2)))
def test_a_process_is_started_once_if_one_of_its_kernels_is_not_on_the_disk(started, monkeypatch, missing, caplog):
    caplog.set_level(logging.INFO, "retrax")
    answers = iter(missing)
    monkeypatch.setattr(kernels, "is_missing", lambda kernel, kinds: next(answers))
    first_use.begin()
    first_use.begin()
    assert len(started) == any(missing)
    assert [record.message[:24] for record in caplog.records] == ["kernels are compiled for"] * any(missing)
    for arguments, options in started:
        assert arguments[:2] == (sys.executable, "-c")
        assert repr(sys.path) in arguments[2]
        assert options["env"]["JAX_PLATFORMS"] == "cpu"


@pytest.mark.parametrize(("count", "may"), [(None, False), (1, False), (2, True), (16, True)])
def test_there_is_none_beside_this_one_on_a_single_processor(started, monkeypatch, count, may):
    monkeypatch.setattr(first_use.os, "cpu_count", lambda: count)
    monkeypatch.setattr(kernels, "is_missing", lambda kernel, kinds: True)
    first_use.begin()
    assert len(started) == may


@pytest.mark.parametrize(
    ("executable", "frozen", "may"),
    [
        ("/usr/bin/python3.13", False, True),
        ("/opt/Python.app/Contents/MacOS/Python", False, True),
        ("/usr/bin/python3.13", True, False),
        ("/opt/blender/blender", False, False),
        ("/opt/python/bin/matlab", False, False),
        ("", False, False),
        (None, False, False),
    ],
)
def test_an_application_with_python_in_it_is_not_started_once_more(started, monkeypatch, executable, frozen, may):
    monkeypatch.setattr(sys, "executable", executable)
    monkeypatch.setattr(sys, "frozen", frozen, raising=False)
    monkeypatch.setattr(kernels, "is_missing", lambda kernel, kinds: True)
    first_use.begin()
    assert len(started) == may


def test_a_system_that_starts_no_process_is_no_error(started, monkeypatch):
    def refused(*arguments, **options):
        raise PermissionError("no more processes")

    monkeypatch.setattr(first_use, "Popen", refused)
    monkeypatch.setattr(kernels, "is_missing", lambda kernel, kinds: True)
    first_use.begin()
    assert first_use.ready(pursuit_kernels.pursue) is pursuit_kernels.pursue


LONG = "import time; time.sleep(60)"


@pytest.mark.parametrize(("code", "status"), [("", 0), ("raise SystemExit(3)", 3), (LONG, None)])
def test_a_process_is_waited_for_until_it_ends_or_for_so_long(monkeypatch, code, status):
    process = subprocess.Popen([sys.executable, "-c", code])
    monkeypatch.setattr(first_use, "_begun", [process])
    monkeypatch.setattr(first_use, "LONGEST", 30.0 if status is not None else 0.2)
    began = time.perf_counter()
    assert first_use.ready(pursuit_kernels.pursue) is pursuit_kernels.pursue
    assert time.perf_counter() - began < 25
    assert process.wait(10) == status or (status is None and process.returncode != 0)


def test_the_kernel_that_passes_call_is_the_one_that_is_compiled_beside(started):
    """A test of all its callers counts its signatures."""
    assert first_use._shared()[0] == (pursuit_kernels.pursue, pursuit_types.PURSUE)


def test_an_interrupt_while_kernels_are_compiled_is_not_held_back(monkeypatch):
    """Nothing is found yet that could be returned; the next call begins anew."""
    set_out, solver = Trial.set_out, Solver(SLEW, Midpoint(Cayley(RIGID)), 5)

    def interrupted(*given):
        monkeypatch.setattr(Trial, "set_out", set_out)
        raise CompilingInterrupted

    monkeypatch.setattr(Trial, "set_out", interrupted)
    with pytest.raises(KeyboardInterrupt):
        solver.solve(*SLEWS)
    assert solver.solve(*SLEWS).success


def test_an_interrupt_while_the_other_process_compiles_is_one_of_these(monkeypatch):
    def interrupted(seconds):
        raise KeyboardInterrupt

    monkeypatch.setattr(first_use, "_begun", [SimpleNamespace(wait=interrupted)])
    with pytest.raises(CompilingInterrupted):
        first_use.ready(pursuit_kernels.pursue)


@pytest.mark.slow
@pytest.mark.parametrize("other", ["compiles", "fails", "none"])
def test_the_first_solve_in_an_environment(tmp_path, other):
    """With its results: kernels come from the disk where the other process has left them, and are the same."""
    failing = tmp_path / "python-that-fails"
    failing.write_text("#!/bin/sh\nexit 1\n")
    failing.chmod(0o755)
    kept = tmp_path / "kept"
    kept.mkdir()
    code = SOLVE.format(other=other, failing=failing)
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(kept), "JAX_ENABLE_X64": "1"}
    ran = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    hits, misses, cost = ran.stdout.split()
    beside = other == "compiles" and (os.cpu_count() or 1) > 1
    assert (int(hits), int(misses)) == ((1, 0) if beside else (0, 1))
    assert float(cost) == pytest.approx(6.0 / (1 - 1 / 64), rel=1e-12)
