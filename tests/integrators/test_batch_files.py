"""Files of batches: what is read is what was written, and what is no whole batch is refused in one sentence."""

import tracemalloc
import zipfile
from dataclasses import replace

import jax
import numpy as np
import pytest
from retrax.integrators import Solutions, load_solution, load_solutions
from retrax.manifolds import InvalidInputError

from .test_record_files import RECORDS, load_trajectory

REGULAR, _ = RECORDS["regular solution"]


@pytest.mark.parametrize("count", [1, 2, 5])
def test_a_batch_is_read_back(count, tmp_path):
    members = [replace(REGULAR, cost=float(k), success=k != 1, times=REGULAR.times * (k + 1)) for k in range(count)]
    Solutions.of(members).save(tmp_path / "batch.npz")
    found = load_solutions(tmp_path / "batch.npz")
    assert len(found) == count
    np.testing.assert_array_equal(found.cost, np.arange(count))
    np.testing.assert_array_equal(found.success, [k != 1 for k in range(count)])
    for one, other in zip(found, members, strict=True):
        assert one.checks == other.checks
        jax.tree.map(
            np.testing.assert_array_equal,
            (one.times, one.states, one.controls),
            (other.times, other.states, other.controls),
        )


def test_a_part_of_a_batch_is_written_alone(tmp_path):
    members = [replace(REGULAR, cost=float(k)) for k in range(4)]
    Solutions.of(members)[1:3].save(tmp_path / "part.npz")
    np.testing.assert_array_equal(load_solutions(tmp_path / "part.npz").cost, [1.0, 2.0])


@pytest.fixture
def written(tmp_path):
    """A file with two members, and its entries."""
    path = tmp_path / "batch.npz"
    Solutions.of([REGULAR, REGULAR]).save(path)
    with zipfile.ZipFile(path) as archive:
        return path, {name: archive.read(name) for name in archive.namelist()}


CHANGES = {
    "another version": {"schema.txt": b"retrax.Solutions 9\n2 members\n"},
    "another count": {"schema.txt": b"retrax.Solutions 1\n3 members\n"},
    "no head": {"schema.txt": None},
    "a member is missing": {"0.npz": None},
    "a member more": {"7.npz": b""},
    "a path": {"../1.npz": b"", "1.npz": None},
    "a damaged member": {"1.npz": b"PK"},
    "no members": {"0.npz": None, "1.npz": None, "schema.txt": b"retrax.Solutions 1\n0 members\n"},
}


@pytest.mark.parametrize("change", CHANGES)
def test_other_archives_are_refused(written, change):
    path, entries = written
    kept = {name: content for name, content in {**entries, **CHANGES[change]}.items() if content is not None}
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in kept.items():
            archive.writestr(name, content)
    with pytest.raises(InvalidInputError, match=r"batch\.npz is not a saved batch") as refused:
        load_solutions(path)
    if change == "another version":
        assert "it begins with 'retrax.Solutions 9' and has 3 entries" in str(refused.value)


def test_other_files_are_refused(written, tmp_path):
    path, _ = written
    for content in (b"", b"PK\x03\x04", path.read_bytes()[:-30]):
        (tmp_path / "other").write_bytes(content)
        with pytest.raises(InvalidInputError, match="other is not a saved batch"):
            load_solutions(tmp_path / "other")
    REGULAR.save(tmp_path / "one.npz")
    with pytest.raises(InvalidInputError, match="try load_solution for a single one"):
        load_solutions(tmp_path / "one.npz")
    with pytest.raises(InvalidInputError, match="is not a saved solution"):
        load_solution(path)
    with pytest.raises(InvalidInputError, match="is not a saved batch: it is a folder"):
        load_solutions(tmp_path)


def test_members_of_other_shapes_are_no_batch(written):
    path, entries = written
    shorter = replace(REGULAR, times=REGULAR.times[:2], stage_times=REGULAR.stage_times[:1])
    cut = {
        name: jax.tree.map(lambda a: a[:2], getattr(REGULAR, name)) for name in ("states", "costates", "body_costates")
    }
    less = {
        name: jax.tree.map(lambda a: a[:1], getattr(REGULAR, name))
        for name in ("stage_states", "stage_costates", "controls", "hamiltonians")
    }
    replace(shorter, **cut, **less).save(path.with_name("1.npz"))
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in entries.items():
            archive.writestr(name, path.with_name("1.npz").read_bytes() if name == "1.npz" else content)
    with pytest.raises(InvalidInputError, match="is not a saved batch"):
        load_solutions(path)


def damaged(content, rng, kind):
    """The bytes with a piece cut out, or with a bit that is another."""
    place = int(rng.integers(len(content)))
    if kind == "cut":
        return content[:place] + content[place + int(rng.integers(1, 2000)) :]
    return content[:place] + bytes([content[place] ^ 1 << int(rng.integers(8))]) + content[place + 1 :]


@pytest.mark.parametrize("kind", ["cut", "flip"])
@pytest.mark.parametrize("load", [load_solutions, load_solution])
def test_damaged_files_are_refused_or_read_as_they_were(written, kind, load, tmp_path):
    path, right = written[0], 0
    if load is load_solution:
        REGULAR.save(path)
    content, rng = path.read_bytes(), np.random.default_rng(0)
    for _ in range(100):
        path.write_bytes(damaged(content, rng, kind))
        try:
            found = load(path)  # a bit may mean nothing, as in the time of a file
        except InvalidInputError as error:
            right += (str(path) in str(error)) and "expected" in str(error)
        else:
            right += kind == "flip" and np.ravel(found.cost)[0] == REGULAR.cost
    assert right == 100


@pytest.mark.parametrize("load", [load_solutions, load_solution, load_trajectory])
@pytest.mark.parametrize("size", [10**5, 10**7, 10**8])
@pytest.mark.usual(2)
def test_a_small_file_that_declares_much_is_refused_before_it_is_read(load, size, tmp_path):
    path = tmp_path / "small.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("times.npy", bytes(size))
    tracemalloc.start()
    with pytest.raises(
        InvalidInputError, match=rf"small\.npz is not .* have {size} bytes, more than the .* of the file"
    ):
        load(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 10 * path.stat().st_size + 10**5
