"""A sweep in one process: what it finds, what it keeps, how it goes on, and what it refuses."""

import logging
import os
import sys
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import replace
from functools import cache, partial

import numpy as np
import pytest
from retrax.compute.threads import in_threads, one_thread
from retrax.integrators import Solver
from retrax.manifolds import InvalidInputError, RetraxError
from retrax.sweeps import Study, load_sweep, sweep
from retrax.sweeps.sweep import AHEAD
from retrax.sweeps.worker import run

from ..support.sweeping import REFUSED, UNREACHED, cases, drift, peaks, study

COUNT, CHUNK = 60, 8  # eight chunks, the last of four members
base = cache(study)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The sweep from one end to the other."""
    return sweep(base, COUNT, tmp_path_factory.mktemp("whole"), chunk=CHUNK)


class Now(Executor):
    """Runs each task when it is submitted; from the one with some number on something else happens."""

    def __init__(self, last=np.inf, instead=None):
        self.last, self.instead, self.tasks = last, instead, 0

    def submit(self, fn, /, *args, **kwargs):
        future = Future()
        try:
            act = fn if self.tasks < self.last else self.instead
            future.set_result(act(*args, **kwargs))
        except BaseException as error:
            future.set_exception(error)
        self.tasks += 1
        return future


def raising(error):
    def act(*_):
        raise error

    return act


def files(found):
    """The chunks of a sweep by when they were written."""
    return {path: path.stat().st_mtime_ns for path in found.folder.glob("chunks/*/*.npz")}


def require_the_same(found, other):
    np.testing.assert_array_equal(found.members, other.members)
    np.testing.assert_array_equal(found.cost, other.cost)
    assert found.result == other.result
    for name, values in other.kept.items():
        np.testing.assert_array_equal(found.kept[name], values)


def test_members_have_the_results_of_solve_many(whole):
    assert whole.complete
    assert len(whole) == whole.count == COUNT
    np.testing.assert_array_equal(whole.members, np.arange(COUNT))
    good = np.setdiff1d(np.arange(COUNT), [REFUSED, UNREACHED])
    direct = base().solver.solve_many(**cases(good))
    np.testing.assert_allclose(whole.cost[good], direct.cost, rtol=1e-9)
    np.testing.assert_allclose(whole.kept["end"][good], direct.states[:, -1], atol=1e-12)
    assert whole.kept["end"].shape == (COUNT, 2)
    assert whole.success[good].all()
    assert whole.converged == len(good)


def test_failed_members_keep_their_reason_and_harm_no_other(whole):
    refused, unreached = whole.result[REFUSED], whole.result[UNREACHED]
    assert "horizon must be a positive" in refused
    assert np.isnan([whole.cost[REFUSED], whole.kept["peak"][REFUSED]]).all()
    assert not whole.success[[REFUSED, UNREACHED]].any()
    assert np.isfinite(whole.cost[UNREACHED]), "that of the best iterate"
    assert {words: members.tolist() for words, members in whole.reasons.items()} == {
        refused: [REFUSED],
        unreached: [UNREACHED],
    }
    assert f"1 as member {REFUSED}: {refused}" in repr(whole)
    assert sum(work.members for work in whole.workers.values()) == COUNT


@pytest.mark.parametrize("size", [1, 7, COUNT, 10 * COUNT])
def test_the_size_of_chunks_and_of_batches_changes_no_result(whole, size, tmp_path, monkeypatch):
    monkeypatch.setattr(sys.modules[Study.__module__], "CHUNK_MEMBERS", max(1, size // 3))
    count = COUNT if size > 1 else 3
    found = sweep(base, count, tmp_path, chunk=size)
    np.testing.assert_allclose(found.cost, whole.cost[:count], rtol=1e-9)
    assert found.result == whole.result[:count]
    assert len(files(found)) == -(-count // size)
    assert [len(part) for part in found.chunks()] == [min(size, count - k) for k in range(0, count, size)]


@pytest.mark.parametrize("finished", range(8))
def test_an_interrupted_sweep_goes_on(whole, finished, tmp_path):
    with pytest.raises(KeyboardInterrupt) as caught:
        sweep(base, COUNT, tmp_path, Now(finished, raising(KeyboardInterrupt())), chunk=CHUNK)
    (part,) = caught.value.args
    assert not part.complete
    np.testing.assert_array_equal(part.members, np.arange(finished * CHUNK))
    np.testing.assert_array_equal(part.cost, whole.cost[: finished * CHUNK])
    before = files(part)
    found = sweep(base, COUNT, tmp_path, chunk=CHUNK)
    require_the_same(found, whole)
    assert {path: files(found)[path] for path in before} == before


def test_chunks_whose_iteration_was_interrupted_are_not_written(whole, tmp_path, monkeypatch):
    asked = Solver.solve_many
    with monkeypatch.context() as patch:
        patch.setattr(Solver, "solve_many", lambda self, **given: asked(self, callback=lambda iteration: True, **given))
        with pytest.raises(KeyboardInterrupt) as caught:
            sweep(base, COUNT, tmp_path, chunk=CHUNK)
    assert len(caught.value.args[0]) == 0
    require_the_same(sweep(base, COUNT, tmp_path, chunk=CHUNK), whole)


@pytest.mark.parametrize("share", [0.0, 0.3, 0.7, 0.99, 1.0])
def test_a_chunk_that_is_cut_off_is_solved_again(whole, share, tmp_path):
    first = sweep(base, COUNT, tmp_path, chunk=CHUNK)
    victim = sorted(files(first))[3]
    content = victim.read_bytes()
    victim.write_bytes(content[: min(int(share * len(content)), len(content) - 1)])
    assert len(load_sweep(tmp_path)) == COUNT - CHUNK
    require_the_same(sweep(base, COUNT, tmp_path, chunk=CHUNK), whole)


def test_a_damaged_chunk_is_named(tmp_path):
    found = sweep(base, CHUNK, tmp_path, chunk=CHUNK)
    (path,) = files(found)
    content = bytearray(path.read_bytes())
    place = content.index(b"cost.npy") + 200
    content[place] ^= 0xFF
    path.write_bytes(content)
    with pytest.raises(InvalidInputError, match=rf"{path.name}.* is not chunk 0 of the sweep"):
        _ = load_sweep(tmp_path).cost


def other_law(q, u, mass):
    return 1.001 * drift(q, u, mass)


def other_cases(members, **how):
    given = cases(members, **how)
    return {**given, "horizons": given["horizons"] + 1e-15}


@pytest.mark.parametrize(
    ("changes", "word"),
    [
        ({"count": COUNT + 1}, "count"),
        ({"chunk": CHUNK + 1}, "chunk"),
        ({"build": partial(study, law=other_law)}, "problem"),
        ({"build": partial(study, steps=5)}, "problem"),
        ({"build": partial(study, of=other_cases)}, "cases"),
    ],
)
def test_a_folder_of_another_sweep_is_refused(whole, changes, word):
    same = {"build": base, "count": COUNT, "folder": whole.folder, "chunk": CHUNK}
    with pytest.raises(InvalidInputError, match=f"another sweep: .*{word}"):
        sweep(**{**same, **changes})


def test_a_folder_with_other_files_is_refused(tmp_path):
    (tmp_path / "thesis.tex").write_text("")
    with pytest.raises(InvalidInputError, match="other files"):
        sweep(base, COUNT, tmp_path)
    with pytest.raises(InvalidInputError, match="is not a sweep"):
        load_sweep(tmp_path)


def test_chunks_that_keep_different_things_are_refused(tmp_path):
    with pytest.raises(KeyboardInterrupt):
        sweep(base, COUNT, tmp_path, Now(2, raising(KeyboardInterrupt())), chunk=CHUNK)
    found = sweep(lambda: replace(base(), keep=lambda s: {"peak": peaks(s)["end"]}), COUNT, tmp_path, chunk=CHUNK)
    assert found.complete
    with pytest.raises(InvalidInputError, match="keep different arrays"):
        _ = found.kept


@pytest.mark.parametrize("chunks", [1, 2])
def test_what_is_kept_since_a_sweep_went_on_is_not_mixed_with_nothing(chunks, tmp_path):
    """Chunks without what is kept now, before those with it; files that are no chunks are left alone."""
    begun = sweep(lambda: replace(base(), keep=None), COUNT, tmp_path, chunk=CHUNK)
    for path in sorted(tmp_path.glob("chunks/*/*.npz"))[chunks:]:
        path.unlink()
    path.with_name("mine.npz").write_bytes(path.read_bytes() if path.exists() else b"")
    found = sweep(base, COUNT, tmp_path, chunk=CHUNK)
    np.testing.assert_array_equal(found.cost, begun.cost)
    with pytest.raises(InvalidInputError, match="keep different arrays"):
        _ = found.kept


def test_a_head_that_was_not_finished_is_none(tmp_path):
    (tmp_path / ".sweep.0123.part").write_text("{")
    assert sweep(base, COUNT, tmp_path, chunk=CHUNK).complete


def test_threads_find_the_same(whole, tmp_path):
    with ThreadPoolExecutor(3) as pool:
        found = sweep(study, COUNT, tmp_path, pool, chunk=CHUNK)
    require_the_same(found, whole)


@pytest.mark.parametrize("finished", [0, 3])
def test_the_end_of_an_executor_says_what_is_there(finished, tmp_path):
    with pytest.raises(BrokenProcessPool) as caught:
        sweep(base, COUNT, tmp_path, Now(finished, raising(BrokenProcessPool("a worker died"))), chunk=CHUNK)
    assert f"{finished * CHUNK} of {COUNT} members are in {tmp_path}" in caught.value.__notes__[0]


def test_workers_that_write_elsewhere_are_found_out(tmp_path):
    with pytest.raises(RetraxError, match=f"16 of {COUNT} members are in .* every worker sees"):
        sweep(
            base,
            COUNT,
            tmp_path,
            Now(2, lambda job, part: run(job._replace(folder=str(tmp_path / "away")), part)),
            chunk=CHUNK,
        )


def test_a_worker_in_another_precision_is_refused(tmp_path):
    with pytest.raises(InvalidInputError, match=r"computes in float64, and .* in float32"):
        sweep(
            base, COUNT, tmp_path, Now(0, lambda job, part: run(job._replace(precision="float32"), part)), chunk=CHUNK
        )


def test_few_chunks_wait_at_a_time(whole, tmp_path, monkeypatch):
    class Later(Executor):
        waiting, most = set(), 0

        def submit(self, fn, /, *args, **kwargs):
            self.waiting.add((fn, args, future := Future()))
            self.most = max(self.most, len(self.waiting))
            if len(self.waiting) == 3 or args[1] == 7:
                for work, given, one in self.waiting:
                    one.set_result(work(*given))
                self.waiting = set()
            return future

    assert AHEAD >= 100
    monkeypatch.setattr(sys.modules[sweep.__module__], "AHEAD", 3)
    later = Later()
    require_the_same(sweep(base, COUNT, tmp_path, later, chunk=CHUNK), whole)
    assert later.most == 3


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"build": 3}, "build must be a function"),
        ({"build": lambda: 3}, "build returned 3"),
        ({"count": 0}, "count must be a whole number"),
        ({"chunk": 2.5}, "chunk must be a whole number"),
        ({"executor": 4}, "executor must be"),
        (
            {"build": lambda: replace(base(), cases=lambda members: {"starts": 1})},
            "cases returned .* expected a dictionary",
        ),
        ({"build": lambda: Study(3, cases)}, "Study takes a Solver"),  # pyright: ignore[reportArgumentType]
    ],
)
def test_other_arguments_are_refused(given, words, tmp_path):
    with pytest.raises(InvalidInputError, match=words):
        sweep(**{"build": base, "count": COUNT, "folder": tmp_path, **given})


@pytest.mark.parametrize("kept", [3, {"a": np.zeros(3)}, {"a": ["x"] * CHUNK}, {4: np.zeros(CHUNK)}])
def test_what_is_kept_has_a_row_for_each_member(kept, tmp_path):
    with pytest.raises(TypeError, match=f"keep returned .* with {CHUNK} rows"):
        sweep(lambda: replace(base(), keep=lambda solutions: kept), CHUNK, tmp_path, chunk=CHUNK)


@pytest.mark.parametrize("verbose", [False, True])
def test_progress_is_logged_where_there_is_no_terminal(verbose, tmp_path, caplog):
    with caplog.at_level(logging.INFO, "retrax"):
        sweep(base, COUNT, tmp_path, chunk=CHUNK, verbose=verbose)
    lines = [record.getMessage() for record in caplog.records if record.name == "retrax"]
    assert len(lines) >= verbose
    assert all(line.startswith("sweep: ") for line in lines)
    assert not verbose or (f"{COUNT} of {COUNT} members" in lines[-1] and lines[-1].endswith("2 without success"))


def test_kernels_of_a_worker_run_in_its_thread():
    def parts():
        found = []
        in_threads(found.append, 64, 1e9)
        return len(found)

    with one_thread():
        assert parts() == 1
    assert parts() == min(64, os.cpu_count() or 1)
