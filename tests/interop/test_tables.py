"""Records as tables: every number is where its name, unit and time say, in xarray, pandas and CSV."""

import csv
import sys

import jax.numpy as jnp
import matplotlib as mpl
import numpy as np
import pytest
from retrax import plotting
from retrax.integrators import OptimalControlProblem, Result, Solver, Trajectory
from retrax.interop import MissingPackageError, to_csv, to_pandas, to_xarray
from retrax.manifolds import SO, Euclidean, InvalidInputError, U, hat
from retrax.retractions import Addition, Cayley, Gauss, Midpoint

mpl.use("Agg")
from matplotlib import pyplot as plt

Q = SO(3) * Euclidean(2)
PROBLEM = OptimalControlProblem(
    Q,
    lambda q, u: (q[0] @ hat(u), u[:2]),
    lambda q, u: u @ u / 2,
    3,
    control_bounds=(-2.0, 2.0),
    labels={"states": ("attitude", ("left", "right, m")), "controls": "rate"},
    units={"states": ("", ("m", "kg")), "controls": "rad/s", "time": "s", "cost": "rad^2/s"},
)
START = np.eye(3), np.zeros(2)


@pytest.fixture(scope="module")
def batch():
    """Two solutions with two steps of two stages, of different lengths."""
    end = np.asarray(Cayley(SO(3))(jnp.eye(3), hat(jnp.array([0.3, 0.1, -0.2])))), None
    return Solver(PROBLEM, Gauss(2, Cayley(Q)), 2).solve_many(START, end, np.array([1.0, 2.0]))


TRAJECTORY = Trajectory(
    np.linspace(0.0, 1.0, 4), (np.broadcast_to(np.eye(3), (4, 3, 3)), np.arange(8.0).reshape(4, 2)),
    (np.zeros((4, 3, 3)), np.ones((4, 2))), np.arange(18.0).reshape(3, 2, 3), np.arange(6.0).reshape(3, 2),
    Result.successful, np.asarray(-1),
)  # fmt: skip


def test_a_data_set_has_named_dimensions_units_and_the_numbers(batch):
    solution = batch[1]
    data = solution.to_xarray()
    np.testing.assert_array_equal(data["attitude"], solution.states[0])
    np.testing.assert_array_equal(data["costate of q[1]"], solution.costates[1])
    np.testing.assert_array_equal(data["q[1]"].sel({"q[1]_0": "right, m"}), solution.states[1][:, 1])
    np.testing.assert_array_equal(data["rate"].isel(stage_time=-1), solution.controls[-1])
    np.testing.assert_array_equal(
        data["multiplier of control_bounds upper"], solution.multipliers["control_bounds upper"]
    )
    np.testing.assert_array_equal(data["hamiltonian"].stage_time, solution.stage_times)
    assert data["attitude"].dims == ("time", "attitude_0", "attitude_1")
    assert data["rate"].attrs == {"units": "rad/s"}
    assert data["time"].attrs == {"units": "s"}
    assert (data.attrs["cost"], data.attrs["cost_units"], data.attrs["success"]) == (solution.cost, "rad^2/s", 1)


def test_a_batch_has_its_members_first(batch):
    data = to_xarray(batch)
    np.testing.assert_array_equal(data["attitude"], batch.states[0])
    np.testing.assert_array_equal(data["time"], batch.times)
    np.testing.assert_array_equal(data["cost"], batch.cost)
    assert data["rate"].dims[:2] == ("member", "stage")
    frame = to_pandas(batch, at="stages")
    np.testing.assert_array_equal(frame.loc[1]["rate[2]"], batch.controls[1, :, 2])
    assert frame.index.names == ["member", "time"]
    with pytest.raises(InvalidInputError, match="no members"):
        to_xarray(batch[:0])


@pytest.mark.parametrize("at", ["nodes", "stages", "times"])
def test_a_frame_has_a_column_for_each_entry(batch, at):
    solution = batch[1]
    times = {"nodes": solution.times, "stages": solution.stage_times, "times": np.array([0.3, 1.7])}[at]
    frame = solution.to_pandas(times if at == "times" else at)
    sample = solution(times)
    np.testing.assert_array_equal(frame.index, times)
    np.testing.assert_allclose(frame["attitude[1,2]"], sample.states[0][:, 1, 2], atol=1e-13)
    np.testing.assert_allclose(frame["left"], sample.states[1][:, 0], atol=1e-13)
    np.testing.assert_allclose(frame["costate of left"], sample.costates[1][:, 0], atol=1e-13)
    units = frame.attrs["units"]
    assert (units["time"], units["left"], units["right, m"], units["attitude[0,0]"]) == ("s", "m", "kg", "")
    assert ("rate[0]" in frame) == (at != "nodes")
    assert ("hamiltonian" in frame) == (at == "stages")
    assert len(frame.columns) == {"nodes": 22, "stages": 22 + 3 + 1 + 6, "times": 25}[at]


@pytest.mark.parametrize("at", ["nodes", "stages"])
def test_a_csv_file_is_read_back_as_it_was(batch, at, tmp_path):
    to_csv(batch, tmp_path / "batch.csv", at)
    with (tmp_path / "batch.csv").open(newline="") as file:
        head, *rows = csv.reader(file)
    frame = to_pandas(batch, at)
    np.testing.assert_array_equal(np.array(rows, float), frame.reset_index())
    assert head[:2] == ["member", "time [s]"]
    assert "right, m [kg]" in head
    to_csv(batch[0], tmp_path / "one.csv", at)
    assert (tmp_path / "one.csv").read_text().startswith('time [s],"attitude[0,0]"')


def test_multipliers_of_boundary_constraints_are_no_rows_of_stages(tmp_path):
    """They have one entry for each equation, here as many as there are stages, and have no place in a table of
    these."""
    plane = Euclidean(2)
    problem = OptimalControlProblem(
        plane,
        lambda q, u: u,
        lambda q, u: u @ u / 2,
        2,
        control_bounds=(-3, 3),
        boundary_constraints={"place": lambda a, b: b - jnp.array([1.0, 2.0])},
    )
    solution = Solver(problem, Midpoint(Addition(plane)), 2).solve(np.zeros(2), None, 1.0)
    data = solution.to_xarray()
    np.testing.assert_array_equal(data["multiplier of place"], solution.multipliers["place"])
    assert data["multiplier of place"].dims == ("place_0",)
    assert data["multiplier of control_bounds upper"].dims == ("stage_time", "control_bounds upper_0")
    assert not any("place" in name for name in solution.to_pandas("stages").columns)
    to_csv(solution, tmp_path / "stages.csv", "stages")
    assert "place" not in (tmp_path / "stages.csv").read_text()
    assert len(plotting.multipliers(solution).lines) == 4  # two bounds from below and two from above
    plt.close("all")


def test_trajectories_have_the_names_of_the_problem_that_is_given():
    data = to_xarray(TRAJECTORY, PROBLEM)
    np.testing.assert_array_equal(data["rate"], np.arange(18.0).reshape(6, 3))
    np.testing.assert_array_equal(data["stage_time"], np.arange(6.0))
    assert to_pandas(TRAJECTORY, problem=PROBLEM)["right, m"].tolist() == [1.0, 3.0, 5.0, 7.0]
    assert list(to_pandas(TRAJECTORY, "stages").columns) == ["u[0]", "u[1]", "u[2]"]


def test_complex_entries_are_two_columns():
    z = jnp.exp(1j * jnp.arange(3.0)).reshape(3, 1, 1)
    record = Trajectory(jnp.arange(3.0), z, 0 * z, None, jnp.arange(2.0), Result.successful, jnp.asarray(-1))
    frame = to_pandas(record, problem=U(1))
    np.testing.assert_allclose(frame["q[Re 0,0]"] + 1j * frame["q[Im 0,0]"], z[:, 0, 0])


@pytest.mark.parametrize("at", ["node", None, "time", [5.0]])
def test_other_places_are_refused(batch, at):
    with pytest.raises(InvalidInputError, match="at must be|the time"):  # noqa: RUF043
        batch[0].to_pandas(at)
    with pytest.raises(InvalidInputError, match="at must be"):
        to_pandas(TRAJECTORY, at)


@pytest.mark.parametrize(("name", "convert"), [("xarray", to_xarray), ("pandas", to_pandas)])
def test_a_missing_package_is_named(monkeypatch, name, convert):
    monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(
        MissingPackageError, match=f"the package {name}, which is not installed; try: pip install {name}"
    ):
        convert(TRAJECTORY)
