"""Sweeps in processes of their own, some of which are killed: what was finished stays, and nothing is lost."""

import os
import shutil
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from retrax.sweeps import load_sweep, sweep

from ..support import sweeping
from ..support.sweeping import CHUNK, COUNT, study

SCRIPT = [sys.executable, str(Path(sweeping.__file__))]
MINUTES = 240.0  # seconds, on a busy machine


@pytest.fixture(scope="module")
def known(tmp_path_factory):
    """The same sweep, here."""
    return sweep(study, COUNT, tmp_path_factory.mktemp("known"), chunk=CHUNK)


def begun(command):
    """A process group in double precision, that of the workers too."""
    return subprocess.Popen(command, start_new_session=True, env={**os.environ, "JAX_ENABLE_X64": "1"})


def until(process, folder, chunks):
    """Wait until some chunks are finished."""
    last = time.monotonic() + MINUTES
    while len(files(folder)) < chunks:
        assert time.monotonic() < last
        assert process.poll() is None, "it ended before"
        time.sleep(0.01)


def files(folder):
    """The files of chunks with the times at which they were written."""
    return {path: path.stat().st_mtime_ns for path in folder.glob("sweep/chunks/*/*.npz")}


def require_the_same(found, known):
    """Nothing is lost, and nothing is twice."""
    assert found.complete
    np.testing.assert_array_equal(found.members, np.arange(COUNT))
    np.testing.assert_allclose(found.cost, known.cost, rtol=1e-9)
    np.testing.assert_array_equal(found.success, known.success)
    np.testing.assert_allclose(found.kept["peak"], known.kept["peak"], rtol=1e-9)
    assert {words: list(members) for words, members in found.reasons.items()} == {
        words: list(members) for words, members in known.reasons.items()
    }


@pytest.mark.slow
def test_a_pool_that_is_killed_goes_on_where_it_was(tmp_path, known):
    process = begun([*SCRIPT, "processes", str(tmp_path), "0.05"])
    until(process, tmp_path, 6)
    os.killpg(process.pid, signal.SIGKILL)
    process.wait(MINUTES)
    finished = files(tmp_path)
    part = load_sweep(tmp_path / "sweep")
    assert 6 * CHUNK <= len(part) < COUNT
    np.testing.assert_allclose(part.cost, known.cost[part.members], rtol=1e-9)
    (tmp_path / "log").unlink()
    whole = sweep(partial(study, str(tmp_path / "log")), COUNT, tmp_path / "sweep", chunk=CHUNK)
    require_the_same(whole, known)
    assert {path: files(tmp_path)[path] for path in finished} == finished, "no finished chunk is written again"
    again = {int(line.split()[0]) for line in (tmp_path / "log").read_text().splitlines()}
    # Its first and last member tell the sweep that it is the same one.
    assert not (again - {0, COUNT - 1}) & set(part.members.tolist()), "no finished member is solved again"


@pytest.mark.slow
def test_a_cluster_of_dask_loses_a_worker_and_no_member(tmp_path, known):
    pytest.importorskip("distributed", reason="the extra cluster is not installed")
    process = begun([*SCRIPT, "dask", str(tmp_path), "0.05"])
    until(process, tmp_path, 4)
    busy = [int(name.rpartition(":")[2]) for name in load_sweep(tmp_path / "sweep").workers]
    assert process.pid not in busy, "the workers are processes of their own"
    os.kill(busy[-1], signal.SIGKILL)
    process.wait(MINUTES)  # a cluster that ends too slowly ends with an error, behind the sweep
    found = load_sweep(tmp_path / "sweep")
    require_the_same(found, known)
    assert len(found.workers) >= 2, "others took over"


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="the launcher is installed on Linux")
def test_ranks_of_mpi(tmp_path, known):
    pytest.importorskip("mpi4py", reason="the extra cluster is not installed")
    launcher = shutil.which("mpiexec", path=f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}")
    how = ["--allow-run-as-root", "--oversubscribe", "-n", "2", SCRIPT[0], "-m", "mpi4py.futures"]
    process = begun([str(launcher), *how, *SCRIPT[1:], "mpi", str(tmp_path), "0"])
    assert process.wait(MINUTES) == 0
    found = load_sweep(tmp_path / "sweep")
    require_the_same(found, known)
    assert len(found.workers) == 1, "one rank leads, the other one works"
