"""Files of solutions and trajectories: what is not a whole record of its kind is refused in one sentence, and never
loaded."""

import io
import pickle
import re
import zipfile
from dataclasses import fields, is_dataclass, replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from retrax.integrators import (
    Guess,
    RegularChecks,
    Result,
    SingularArc,
    SingularChecks,
    Solution,
    Statistics,
    Trajectory,
    load_solution,
    load_trajectory,
)
from retrax.integrators.boundary_value.solution.interpolation import Interpolant
from retrax.integrators.boundary_value.solution.names_elsewhere import OFFERED
from retrax.manifolds import SO, Euclidean, InvalidInputError, Product
from retrax.retractions import default_retraction

N = 3
RANDOM = np.random.default_rng(0)


def along(count: int) -> tuple:
    """States of a product along nodes or stages."""
    return (RANDOM.normal(size=(count, 3, 3)), RANDOM.normal(size=(count, 2))), RANDOM.normal(size=count)


TIMES = np.linspace(0.0, 1.0, N + 1)
NUMBERS = 1e-15, 2e-14, {"kind": 1e-16, "x/0": 0.0}, 0.5, 1e-3, 1.0, {"SO(3)": 1e-12}, {"SO(3)": 3}
CHECKS = SingularChecks(*NUMBERS)
ARC = SingularArc(4, 1, 1, "rattle: because", True, {"start": 1e-12}, 3, "positive")
SOLUTION = Solution(
    TIMES, along(N + 1), along(N + 1), TIMES[:-1] + 0.1, along(N), along(N), RANDOM.normal(size=(N, 2)),
    np.full(N, 0.5), {"SO(3)": np.ones((N + 1, 3))}, {"SO(3)": np.ones((N + 1, 3))}, {}, 0.7, True, "Solved.", CHECKS,
    Statistics(4, 0.1, 0.2), ARC,
)  # fmt: skip
TRAJECTORY = Trajectory(
    jnp.asarray(-TIMES), *jax.tree.map(jnp.asarray, (along(N + 1), along(N + 1))), jnp.ones((N, 5, 2)),
    -jnp.asarray(TIMES[:-1, None] + np.linspace(0.0, 0.3, 5)), Result.step_not_solved, jnp.asarray(7),
)  # fmt: skip
PLACES = Product(SO(3) * Euclidean(2), Euclidean(()))
BETWEEN = Interpolant(default_retraction(PLACES), Euclidean(2))
RECORDS = {
    "solution with polynomials": (replace(SOLUTION, interpolant=BETWEEN), load_solution),
    "solution": (SOLUTION, load_solution),
    "regular solution": (
        replace(SOLUTION, singular=None, momenta={}, checks=RegularChecks(*NUMBERS, True)),
        load_solution,
    ),
    "trajectory": (TRAJECTORY, load_trajectory),
    "trajectory without controls": (replace(TRAJECTORY, controls=None), load_trajectory),
}


@pytest.fixture(params=["solution with polynomials", "trajectory"])
def record(request):
    return RECORDS[request.param]


def contents(record) -> dict:
    """The fields of a record, with those of the records in it."""
    values = {field.name: getattr(record, field.name) for field in fields(record)}
    return {
        name: contents(value) if is_dataclass(value) and name != "result" else value for name, value in values.items()
    }


def same(one, other) -> bool:
    """Equal in structure, types and bits."""
    return bool(eqx.tree_equal(contents(one), contents(other), typematch=True))


def saved(record, tmp_path):
    """The path of a file of the record, and its bytes."""
    path = tmp_path / "record.npz"
    record.save(path)
    return path, path.read_bytes()


def require_refused(load, path) -> None:
    """Refused in one sentence, which names the file and what was expected."""
    with pytest.raises(
        InvalidInputError, match=rf"(?s){re.escape(str(path))} is not a saved .*; expected a file from \w+.save"
    ):
        load(path)


@pytest.mark.parametrize("name", RECORDS)
def test_what_was_saved_is_loaded_bit_by_bit(name, tmp_path):
    record, load = RECORDS[name]
    path, _ = saved(record, tmp_path)
    assert same(load(path), record)
    assert repr(load(path)) == repr(record)


MUTATIONS = {
    "a word": lambda a: np.asarray("nothing"),
    "a number": lambda a: np.asarray(0.25),
    "words": lambda a: np.full((N + 1, 3), "no"),
    "yes": lambda a: np.asarray("yes"),
    "whole numbers": lambda a: np.ones(a.shape, np.int64),
    "half precision": lambda a: np.ones(a.shape, np.float16),
    "truth values": lambda a: np.ones(a.shape, bool),
    "bytes": lambda a: np.ones(a.shape, "S3"),
    "fields": lambda a: np.zeros(a.shape, [("x", float)]),
    "one more": lambda a: np.concatenate([a, a[-1:]]) if a.ndim else np.stack([a, a]),
    "one less": lambda a: a[1:] if a.ndim else a[None],
    "one axis more": lambda a: a[None],
    "not a number": lambda a: np.full_like(a, np.nan),
    "infinite": lambda a: np.full_like(a, np.inf),
    "objects": lambda a: np.full(a.shape, None, object),
}


def differs(one: np.ndarray, other: np.ndarray) -> bool:
    """Whether a mutation has made something else of an entry, in kind."""
    finite = [a.dtype.kind == "f" and bool(np.isfinite(a).all()) for a in (one, other)]
    return one.shape != other.shape or one.dtype.kind != other.dtype.kind or finite[0] != finite[1]


# Of the entries of a trajectory all, of those of a solution one of each kind: a number, another kind, size, order.
ALIKE = "a word", "words", "yes", "whole numbers", "truth values", "bytes", "one more", "one axis more", "infinite"


@pytest.mark.long(*(f"solution with polynomials-{mutation}" for mutation in ALIKE))
@pytest.mark.parametrize("mutation", MUTATIONS)
def test_an_entry_that_is_something_else_is_refused(record, mutation, tmp_path):
    """Each entry in turn, also a pickle that would be executed by a loader that allowed it."""
    path, _ = saved(record[0], tmp_path)
    entries = dict(np.load(path))
    for name, array in entries.items():
        if mutation in ("not a number", "infinite") and array.dtype.kind != "f":
            continue
        other = MUTATIONS[mutation](array)
        if not differs(array, other) and mutation != "half precision":
            continue
        np.savez(path, **{**entries, name: other})
        require_refused(record[1], path)


def test_an_entry_that_is_missing_renamed_added_or_double_is_refused(record, tmp_path):
    path, _ = saved(record[0], tmp_path)
    entries = dict(np.load(path))
    for name in entries:
        others = {key: array for key, array in entries.items() if key != name}
        for changed in (others, {**others, f"{name}x": entries[name]}, {**entries, f"{name}/9": entries[name]}):
            np.savez(path, **changed)
            require_refused(record[1], path)
    np.savez(path, **entries)
    with zipfile.ZipFile(path, "a") as archive, pytest.warns(UserWarning, match="Duplicate"):
        archive.writestr("times.npy", archive.read("times.npy"))
    require_refused(record[1], path)


def test_a_file_that_is_cut_anywhere_is_refused(record, tmp_path):
    path, content = saved(record[0], tmp_path)
    for end in [*range(0, len(content), 197), len(content) - 1]:
        path.write_bytes(content[:end])
        require_refused(record[1], path)


def test_a_byte_that_flips_anywhere_is_refused_or_means_nothing(record, tmp_path):
    """What is stored has a checksum; in the archive's tables some bytes, such as the dates, mean nothing to the
    record."""
    path, content = saved(record[0], tmp_path)
    refused = 0
    for position in range(0, len(content), 179):
        flipped = bytearray(content)
        flipped[position] ^= 1 << position % 8
        path.write_bytes(flipped)
        try:
            loaded = record[1](path)
        except InvalidInputError:
            refused += 1
        else:
            assert same(loaded, record[0])
    assert refused > 0.5 * len(content) / 179


def test_an_entry_that_is_longer_than_its_array_is_refused(record, tmp_path):
    path, _ = saved(record[0], tmp_path)
    with zipfile.ZipFile(path) as archive:
        entries = {name: archive.read(name) for name in archive.namelist()}
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in entries.items():
            archive.writestr(name, content + (b"0" if name == "times.npy" else b""))
    with pytest.raises(InvalidInputError, match="an entry is longer than its array"):
        record[1](path)


class Dangerous:
    """Something whose pickle writes a file when it is read."""

    def __reduce__(self):
        return exec, ("raise SystemExit('executed')",)


@pytest.mark.parametrize(
    "kind", ["empty", "text", "array", "pickle", "archive", "folder", "other record", "zip of text"]
)
def test_what_is_no_record_is_refused(record, kind, tmp_path):
    path = tmp_path / "thing.npz"
    buffer = io.BytesIO()
    if kind == "array":
        np.save(buffer, np.zeros(3))
    elif kind == "archive":
        np.savez(buffer, cost=np.zeros(()), controls=np.zeros(3))
    elif kind == "other record":
        next(other for other, _ in RECORDS.values() if type(other) is not type(record[0])).save(path)
        buffer = io.BytesIO(path.read_bytes())
    elif kind == "zip of text":
        with zipfile.ZipFile(buffer, "w") as archive:
            archive.writestr("times.npy", "0 1 2")
    written = {"empty": b"", "text": b"x, y\n1, 2\n", "pickle": pickle.dumps(Dangerous())}.get(kind, buffer.getvalue())
    if kind == "folder":
        path.mkdir()
    else:
        path.write_bytes(written)
    require_refused(record[1], path)
    np.savez(tmp_path / "pickled.npz", schema=np.asarray([Dangerous()], object))
    require_refused(record[1], tmp_path / "pickled.npz")


@pytest.mark.parametrize("version", [0, 3, 10, "one"])
def test_another_version_is_refused_in_words(record, version, tmp_path):
    path, _ = saved(record[0], tmp_path)
    name = type(record[0]).__name__
    expected = f"retrax.{name} {'7' if name == 'Solution' else '1'}"
    np.savez(path, **{**np.load(path), "schema": np.asarray(f"retrax.{name} {version}")})
    with pytest.raises(
        InvalidInputError, match=f"schema retrax.{name} {version}, where this version .* reads '{expected}'"
    ):
        record[1](path)


def test_the_other_kind_of_record_is_said_to_have_another_function(record, tmp_path):
    path, _ = saved(record[0], tmp_path)
    kinds = {"Solution": (load_trajectory, "load_solution"), "Trajectory": (load_solution, "load_trajectory")}
    other, words = kinds[type(record[0]).__name__]
    with pytest.raises(InvalidInputError, match=rf"; try {words}; expected a file from"):
        other(path)


@pytest.mark.parametrize("path", [5, None, 1.0, ["record.npz"]])
def test_what_is_no_path_is_named(record, path):
    require_refused(record[1], path)
    with pytest.raises(InvalidInputError, match=r"the path must be a text or a pathlib\.Path, got "):
        record[0].save(path)


def test_a_file_is_written_into_a_folder_that_exists(record, tmp_path):
    with pytest.raises(InvalidInputError, match=r"the path .*nowhere.* leads to a folder that does not exist, .*mkdir"):
        record[0].save(tmp_path / "nowhere" / "record.npz")
    with pytest.raises(InvalidInputError, match=r"the path .* is that of a folder, expected one of a file"):
        record[0].save(tmp_path)


GUESSED = (  # names of other libraries, with what they stand for
    *(("x", "states"), ("y", "states"), ("X", "states"), ("trajectory", "states"), ("history", "states")),
    *(("U", "controls"), ("input", "controls"), ("inputs", "controls"), ("lam", "costates")),
    *((name, "cost") for name in ("J", "fun", "value", "objective", "cost_value")),
    *((name, "horizon") for name in ("T", "tf", "duration")),
    *((name, "statistics.iterations") for name in ("nit", "niter", "n_iter", "nfev", "iterations")),
    *(("N", "steps"), ("h", "np.diff(solution.times)"), ("dt", "np.diff(solution.times)")),
    *(("converged", "success"), ("exitflag", "status"), ("error", "checks.error")),
    *(("cpu_time", "statistics.run_seconds"), ("at", "solution(t)")),
)
MISSPELT = ("state", "states"), ("control", "controls"), ("requires_success", "require_success")


@pytest.mark.parametrize(("name", "words"), [*GUESSED, *MISSPELT])
def test_an_attribute_of_a_solution_is_found_by_a_similar_name(name, words):
    with pytest.raises(AttributeError) as raised:
        getattr(SOLUTION, name)
    assert str(raised.value) == f"a Solution has no attribute {name!r}; did you mean {words}?"


@pytest.mark.parametrize("offered", OFFERED)
def test_a_hint_names_an_attribute_that_is_there(offered):
    """Only names that a solution does not have get a hint."""
    expression = offered if "solution" in offered else f"solution.{offered}"
    eval(expression.removesuffix("(t)"), {"solution": SOLUTION, "np": np})
    assert not [name for name in OFFERED[offered] if hasattr(SOLUTION, name)]


def test_other_attributes_of_a_solution_are_none():
    assert not hasattr(SOLUTION, "weather")
    assert not hasattr(SOLUTION, "__array__")
    assert pickle.loads(pickle.dumps(SOLUTION)).cost == SOLUTION.cost


def test_a_file_that_is_not_there_is_the_usual_error(record, tmp_path):
    with pytest.raises(FileNotFoundError):
        record[1](tmp_path / "nothing.npz")


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"states": along(N)}, "states has the length 3, expected 4, one for each of the nodes"),
        ({"stage_times": TIMES}, "stage_states has the length 3, expected 4, one for each of the stages"),
        ({"success": "yes"}, "success is 'yes', expected a value of type bool"),
        ({"cost": float("nan")}, "cost has entries that are NaN"),
        ({"times": TIMES[[0, 2, 1, 3]]}, "times are not finite real numbers in ascending or descending order"),
        ({"controls": [[1.0, 2.0]] * N}, "controls is .*expected an array of numbers"),
        ({"momenta": np.ones((N + 1, 3))}, "momenta is an array .*expected values by their names"),
        ({"checks": 0.5}, "checks is 0.5, expected the fields defect, stationarity"),
        ({"cost": (1.0, 2.0)}, "cost is a tuple of 2, expected a value of type float"),
        ({"parameters": {1: 2.0}}, "parameters has a key that is no word"),
        ({"parameters": {"mass": "heavy"}}, "parameters is 'heavy', expected real numbers and arrays"),
        (
            {"stage_times": TIMES, "stage_states": along(N + 1), "stage_costates": along(N + 1)}
            | {"controls": np.ones((N + 1, 2)), "hamiltonians": np.ones(N + 1)},
            "it has 4 nodes and 4 stages, expected as many stages for each step between nodes",
        ),
    ],
)
def test_a_solution_that_could_not_be_read_again_is_not_written(changes, words, tmp_path):
    with pytest.raises(InvalidInputError, match=f"this solution cannot be saved: ({words})"):
        replace(SOLUTION, **changes).save(tmp_path / "wrong.npz")
    assert not (tmp_path / "wrong.npz").exists()


def test_an_unfinished_solution_may_have_entries_that_are_not_numbers(tmp_path):
    """It says so in words; to look at it is what it is saved for."""
    unfinished = replace(SOLUTION, success=False, cost=float("nan"), controls=np.full((N, 2), np.nan))
    unfinished.save(tmp_path / "unfinished.npz")
    assert np.isnan(load_solution(tmp_path / "unfinished.npz").controls).all()


def test_complex_controls_of_a_real_manifold_are_refused(tmp_path):
    replace(SOLUTION, interpolant=BETWEEN).save(tmp_path / "solution.npz")
    values = dict(np.load(tmp_path / "solution.npz"))
    for name, unit in (("controls", 1j), ("controls", 1 + 0j)):
        np.savez(tmp_path / "complex.npz", **{**values, name: unit * values[name]})
        with pytest.raises(InvalidInputError, match=f"{name} are complex, expected real numbers"):
            load_solution(tmp_path / "complex.npz")


@pytest.mark.parametrize(
    ("result", "failed"), [("successful", 3), ("step_not_solved", -1), ("interrupted", 0), ("singular", -1)]
)
def test_a_trajectory_and_its_result_agree(result, failed, tmp_path):
    path, _ = saved(TRAJECTORY, tmp_path)
    np.savez(path, **{**np.load(path), "result": np.asarray(result), "failed_step": np.asarray(failed)})
    with pytest.raises(
        InvalidInputError, match=r"the failed step is|the result is 'singular', expected one of successful"
    ):
        load_trajectory(path)


def test_a_batch_of_trajectories_is_saved_one_by_one(tmp_path):
    batch = jax.tree.map(lambda a: jnp.stack([a, a]), TRAJECTORY)
    with pytest.raises(InvalidInputError, match=r"batch .* times of shape \(2, 4\); save each"):
        batch.save(tmp_path / "batch.npz")
    with pytest.raises(InvalidInputError, match="outside jit"):
        jax.jit(lambda path: path.save(tmp_path / "traced.npz"))(TRAJECTORY)


@pytest.mark.parametrize("count", [1, 10, 300])
def test_a_record_prints_on_one_screen(count):
    """Whatever the number of nodes, of factors, and of groups among them."""
    many = tuple(np.zeros((count, 3, 3)) for _ in range(count))
    named = {f"factor {i}": np.zeros((count, 3)) for i in range(count)}
    solution = replace(SOLUTION, times=np.arange(count), states=many, costates=many, controls=many, momenta=named)
    trajectory = replace(TRAJECTORY, times=jnp.arange(float(count)), q=many, p=many, controls=many)
    for printed in (solution, trajectory, Guess(many, many, many), jax.tree.map(lambda a: a[None], trajectory)):
        lines = repr(printed).splitlines()
        assert len(lines) <= 24
        assert max(map(len, lines)) <= 400
    assert "cost=0.7" in repr(solution)
    assert "f64" in repr(Guess(SOLUTION.states, SOLUTION.controls))
