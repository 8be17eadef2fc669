"""Pictures hold the numbers of the record, under the names and units of the problem, on the axes that are given."""

from dataclasses import replace
from typing import Any, NamedTuple

import jax.numpy as jnp
import matplotlib as mpl
import numpy as np
import pytest
from retrax import plotting
from retrax.integrators import OptimalControlProblem, Quantities, Quantity, Result, Trajectory, solve
from retrax.interop import to_casadi
from retrax.manifolds import SO, Euclidean, InvalidInputError, Sphere, hat
from retrax.named_columns import NamedColumn, join_names
from retrax.retractions import Addition, Cayley, Exponential, Gauss, Midpoint, Theta
from scipy.spatial.transform import Rotation

mpl.use("Agg")
from matplotlib import pyplot as plt

pytestmark = pytest.mark.usefixtures("traced_once")

Q = SO(3) * Euclidean(2)
BOUND = 0.45


def dynamics(q, u):
    """A body that is turned, and two integrators beside it, of which the second is driven by the first's square."""
    R, x = q
    return R @ hat(u), jnp.stack([u[0] + 0.0 * x[0], x[0] * u[1]])


PROBLEM = OptimalControlProblem(
    Q,
    dynamics,
    lambda q, u: u @ u / 2 + 2 * q[1][0] ** 2,
    3,
    control_bounds=(-BOUND, [BOUND, np.inf, np.inf]),
    labels={"states": ("attitude", ("left", "right")), "controls": "rate"},
    units={"states": ("", ("m", "kg")), "controls": "rad/s", "time": "s"},
)
METHOD, STEPS = Midpoint(Cayley(Q)), 6
START = np.eye(3), np.zeros(2)
END = Rotation.from_rotvec([1.0, -0.4, 0.3]).as_matrix(), None


@pytest.fixture(scope="module")
def solved():
    """A solution with a bound that holds it for a while, and its iterations."""
    iterations = []
    return solve(PROBLEM, START, END, 3.0, method=METHOD, steps=STEPS, callback=iterations.append), iterations


def made_by_hand(**arrays):
    """A trajectory with these states, zero covectors and no controls."""
    times = jnp.linspace(0.0, 2.0, len(next(iter(arrays.values()))))
    q = tuple(arrays.values()) if len(arrays) > 1 else next(iter(arrays.values()))
    return Trajectory(times, q, q, None, times[1:], Result.successful, jnp.asarray(-1))


def poses(n, count=9):
    """Poses in the plane or in space that go along a line and turn about the last axis."""
    turn = Rotation.from_rotvec(np.linspace(0, 2, count)[:, None] * [0, 0, 1]).as_matrix()
    found = np.zeros((count, n + 1, n + 1))
    found[:, :n, :n], found[:, :n, n], found[:, n, n] = (
        turn[:, :n, :n],
        np.linspace(0, 1, count)[:, None] + np.arange(n),
        1,
    )
    return found


def curves(axis):
    """The lines of the axes without the dashed lines of bounds."""
    return [line for line in axis.lines if line.get_linestyle() != "--"]


def test_histories_are_the_numbers_with_names_and_units(solved):
    solution, _ = solved
    attitude, beside, control = plotting.histories(solution)
    assert all(
        tick.label1.get_visible() for axis in (attitude, beside, control) for tick in axis.xaxis.get_major_ticks()
    )
    vectors = Rotation.from_matrix(solution.states[0]).as_rotvec()
    for axis, values in (
        (attitude, vectors),
        (beside, solution.states[1]),
        (control, np.concatenate([solution.controls, solution.controls[-1:]])),
    ):
        drawn, times = np.stack([line.get_ydata() for line in curves(axis)], axis=1), axis.lines[0].get_xdata()
        places = np.searchsorted(times, solution.times)
        np.testing.assert_allclose(times[places], solution.times, atol=1e-15)
        np.testing.assert_allclose(drawn[places], values, atol=1e-14)
        assert axis.get_xlabel() == "time [s]"
    assert [axis.get_ylabel() for axis in (attitude, beside, control)] == [
        "attitude, rotation vector [rad]",
        "left, right",
        "rate [rad/s]",
    ]
    legends = [[text.get_text() for text in axis.get_legend().get_texts()] for axis in (attitude, beside, control)]
    assert legends == [["x", "y", "z"], ["left [m]", "right [kg]"], ["x", "y", "z"]]


def with_controls(fractions, places=("u",), unit="N"):
    """A view of three steps with a control of one entry for each place, at these fractions of each step."""
    times = np.array([0.0, 1.0, 3.0, 4.0])
    stages = (times[:-1, None] + np.diff(times)[:, None] * fractions).ravel()
    values = np.arange(1.0, stages.size + 1)
    quantities = Quantities((), tuple(Quantity(place, (unit,), ("0",), "") for place in places))
    trajectory = Trajectory(
        times,
        (),
        (),
        tuple(values.reshape(3, -1, 1) for _ in places),
        stages.reshape(3, -1),
        Result.successful,
        jnp.asarray(-1),
    )
    return trajectory, quantities, stages, values


@pytest.mark.parametrize(("fractions", "is_held"), [([0.0], True), ([0.5], True), ([0.8], False), ([0.2, 0.8], False)])
def test_controls_are_steps_where_each_step_has_one(fractions, is_held):
    record, quantities, stages, values = with_controls(fractions)
    (line,) = plotting.controls(record, quantities).lines
    assert line.get_drawstyle() == ("steps-post" if is_held else "default")
    np.testing.assert_array_equal(line.get_xdata(), record.times if is_held else stages)
    np.testing.assert_array_equal(line.get_ydata(), [*values, values[-1]] if is_held else values)


def test_the_steps_of_a_solution_begin_and_end_at_its_nodes(solved):
    solution, _ = solved
    backward = solve(PROBLEM, START, END, 3.0, method=Theta(Cayley(Q), 1.0), steps=STEPS)
    for found in (solution, backward):
        for axis in (plotting.controls(found), plotting.optimality(found)[0], plotting.histories(found)[-1]):
            assert [line.get_drawstyle() for line in curves(axis)] == 3 * ["steps-post"]
            np.testing.assert_array_equal(axis.lines[0].get_xdata(), found.times)
            np.testing.assert_array_equal(axis.lines[0].get_ydata()[:-1], found.controls[:, 0])
    both = solve(PROBLEM, START, END, 3.0, method=Gauss(2, Cayley(Q)), steps=STEPS)
    for axis in (plotting.controls(both), plotting.optimality(both)[0], plotting.histories(both)[-1]):
        assert axis.lines[0].get_drawstyle() == "default"
        times, values = axis.lines[0].get_data()
        first = np.flatnonzero(np.diff(times) == 0) + 1  # where a step ends and the next begins
        np.testing.assert_allclose(times[first], both.times[1:-1], atol=1e-14)
        for step, (own_times, own) in enumerate(zip(np.split(times, first), np.split(values, first), strict=True)):
            stages = slice(2 * step, 2 * step + 2)
            line = np.polyfit(both.stage_times[stages], both.controls[stages, 0], 1)
            np.testing.assert_allclose(own, np.clip(np.polyval(line, own_times), -BOUND, BOUND), atol=1e-12)


@pytest.mark.parametrize("steps", [1, 3, 150, 500])
@pytest.mark.usual(1)
def test_a_solution_is_drawn_between_its_nodes_and_a_file_without_a_retraction_is_not(steps, tmp_path):
    """By many points of few steps, by few of many: those of the solution itself."""
    plane = Euclidean(2)
    problem = OptimalControlProblem(plane, lambda q, u: jnp.stack([q[1], u[0]]), lambda q, u: u @ u / 2, 1)
    solution = solve(problem, np.zeros(2), np.array([1.0, 0.0]), 1.0, method=Gauss(2, Addition(plane)), steps=steps)
    (line,) = plotting.controls(solution).lines
    times, values = plotting.histories(solution)[0].lines[0].get_data()
    assert 200 <= len(times) <= 2000
    np.testing.assert_allclose(values, solution(times).states[:, 0], atol=1e-13)
    assert np.all(np.diff(times) >= 0)
    np.testing.assert_array_equal(line.get_xdata(), times)
    bare = replace(solution, interpolant=None)
    np.testing.assert_array_equal(plotting.histories(bare)[0].lines[0].get_xdata(), solution.times)


@pytest.mark.parametrize("stages", [1, 3])
def test_a_solution_without_controls_is_drawn_by_its_states(stages):
    line = Euclidean(1)
    problem = OptimalControlProblem(line, lambda q, u: -q, lambda q, u: q @ q, 0)
    method = Gauss(stages, Addition(line))
    solution = solve(problem, np.ones(1), None, 1.0, method=method, steps=4)
    (axis,) = plotting.histories(solution)
    times, values = axis.lines[0].get_data()
    np.testing.assert_allclose(values, np.exp(-times), atol=2e-2)
    with pytest.raises(InvalidInputError, match="no controls"):
        plotting.controls(solution)


def test_the_sphere_is_round():
    """What is drawn on it has one scale, wherever the curve is."""
    record = made_by_hand(q=Rotation.from_rotvec(np.linspace(0, 0.3, 5)[:, None] * [1, 0, 0]).as_matrix()[:, 1])
    axis = plotting.path(record, problem=Sphere(2))
    spans = [np.ptp(limits) for limits in (axis.get_xlim(), axis.get_ylim(), axis.get_zlim())]
    np.testing.assert_allclose(spans, spans[0], rtol=1e-12)


def test_entries_without_names_are_x_y_z_where_there_are_three_and_nothing_where_there_is_one():
    def labels(entries, units=("m",)):
        return NamedColumn("q", entries, units, np.zeros((2, len(entries)))).labels

    assert labels(("0", "1", "2")) == ["x", "y", "z"]
    assert labels(("0", "1", "2"), ("m", "m", "m")) == ["x", "y", "z"]
    assert labels(("0", "1", "2"), ("m", "m", "rad")) == ["0 [m]", "1 [m]", "2 [rad]"]
    assert labels(("a", "b", "c")) == ["a", "b", "c"]
    assert labels(("0", "1")) == ["0", "1"]
    assert labels(("0",)) == [""]
    record, quantities, *_ = with_controls([0.5])
    axis = plotting.controls(record, quantities)
    assert axis.get_legend() is None
    assert axis.get_ylabel() == "u [N]"


def test_controls_of_several_arrays_have_the_names_of_these():
    record, quantities, *_ = with_controls([0.5], places=("thrust", "torque"))
    axis = plotting.controls(record, quantities)
    assert [text.get_text() for text in axis.get_legend().get_texts()] == ["thrust [N]", "torque [N]"]
    assert axis.get_ylabel() == "controls"


class Pictures(NamedTuple):
    """Functions that draw, by their names: on flat axes, on axes of three dimensions, and on several axes."""

    flat: dict[str, Any]
    spatial: dict[str, Any]
    panels: dict[str, tuple[int, Any]]  # with the numbers of axes


@pytest.fixture
def pictures(solved):
    solution, iterations = solved
    sphere = made_by_hand(q=Rotation.from_rotvec(np.linspace(0, 1, 5)[:, None] * [1, 0, 0]).as_matrix()[:, 1])
    discrete = to_casadi(PROBLEM, METHOD, START, END, 3.0, 2)
    coordinates = lambda q, p: q[0], lambda q, p: q[1] * p[2]
    flat = {
        "attitude": lambda ax: plotting.attitude(solution, ax=ax),
        "conserved": lambda ax: plotting.conserved(solution, ax=ax),
        "controls": lambda ax: plotting.controls(solution, ax=ax),
        "convergence": lambda ax: plotting.convergence(iterations, ax=ax),
        "energy": lambda ax: plotting.energy(sphere, coordinates[0], ax=ax),
        "multipliers": lambda ax: plotting.multipliers(solution, ax=ax),
        "path": lambda ax: plotting.path(solution, 1, ax=ax),
        "phase_portrait": lambda ax: plotting.phase_portrait(sphere, coordinates, ax=ax),
        "slopes": lambda ax: plotting.slopes(Cayley(SO(2)), seeds=[0], ax=ax),
        "sparsity": lambda ax: plotting.sparsity(discrete, ax=ax),
        "state": lambda ax: plotting.state(solution, 1, ax=ax),
        "switching": lambda ax: plotting.switching(PROBLEM, solution, ax=ax),
    }
    spatial = {
        "body_axes": lambda ax: plotting.body_axes(solution, ax=ax),
        "path": lambda ax: plotting.path(sphere, problem=Sphere(2), ax=ax),
    }
    panels = {
        "histories": (3, lambda ax: plotting.histories(solution, ax=ax)),
        "optimality": (3, lambda ax: plotting.optimality(solution, PROBLEM, ax=ax)),
    }
    return Pictures(flat, spatial, panels)


def test_every_picture_is_drawn_into_the_axes_that_are_given(pictures):
    assert {*pictures.flat, *pictures.spatial, *pictures.panels, "to_html"} == set(plotting.__all__)
    for draw in pictures.flat.values():
        ax = plt.figure().add_subplot()
        assert draw(ax) is ax
        assert ax.has_data()
    for draw in pictures.spatial.values():
        ax = plt.figure().add_subplot(projection="3d")
        assert draw(ax) is ax
    for count, draw in pictures.panels.values():
        _, axes = plt.subplots(count)
        assert list(draw(axes)) == list(axes)
    plt.close("all")


def test_axes_of_another_kind_or_number_are_refused(pictures):
    for draw in pictures.spatial.values():
        with pytest.raises(InvalidInputError, match="three dimensions"):
            draw(plt.figure().add_subplot())
    for count, draw in pictures.panels.values():
        for wrong in (1, 2, 4):
            with pytest.raises(InvalidInputError, match=f"must be {count} axes"):
                draw(plt.subplots(wrong)[1])
    with pytest.raises(InvalidInputError, match="flat axes"):
        pictures.flat["attitude"](plt.figure().add_subplot(projection="3d"))
    plt.close("all")


def test_a_picture_makes_a_figure_only_if_no_axes_are_given(pictures):
    panels = (draw for _, draw in pictures.panels.values())
    for draw in (*(pictures.flat[name] for name in ("attitude", "convergence", "path")), *panels):
        axes = np.ravel(draw(None))
        assert len(plt.get_fignums()) == 1
        assert all(ax.figure is axes[0].figure for ax in axes)
        plt.close(axes[0].figure)
    for draw in pictures.flat.values():
        draw(plt.figure().add_subplot())
        assert len(plt.get_fignums()) == 1
        plt.close("all")


def test_switching_functions_are_what_the_multipliers_hold(solved):
    solution, _ = solved
    lower, upper = (solution.multipliers[f"control_bounds {side}"] for side in ("lower", "upper"))
    assert upper.max() > 0.1, "the bound holds"
    axis = plotting.switching(PROBLEM, solution)
    drawn = np.stack([line.get_ydata() for line in axis.lines if len(line.get_xdata()) == STEPS], axis=1)
    np.testing.assert_allclose(drawn, upper - lower, atol=1e-8)
    top = plotting.optimality(solution, PROBLEM)[0]
    dashed = {line.get_ydata()[0] for line in top.lines if line.get_linestyle() == "--"}
    assert dashed == {-BOUND, BOUND}


def test_the_legend_names_the_multipliers_that_hold_the_trajectory_in_any_unit(solved):
    solution, _ = solved
    upper = solution.multipliers["control_bounds upper"]
    assert solution.checks.active["control_bounds upper"] > 0
    rows = {"control_bounds upper": upper, "small unit": 1e-20 * upper, "idle": np.full((STEPS, 2), 1e-12)}
    active = {"control_bounds upper": 3, "small unit": 3, "idle": 0}
    for counts in (active, dict.fromkeys(active, 0)):
        drawn = replace(solution, multipliers=rows, checks=replace(solution.checks, active=counts))
        legend = plotting.multipliers(drawn).get_legend()
        names = {text.get_text().partition("[")[0] for text in legend.get_texts()} if legend else set()
        assert names == {name for name, count in counts.items() if count}


def test_errors_of_what_is_conserved_are_those_of_the_report(solved):
    solution, _ = solved
    axis = plotting.conserved(solution)
    lines = {line.get_label(): np.asarray(line.get_ydata()) for line in axis.lines}
    for name, worst in solution.checks.violations.items():
        label = name.replace("factor 0", "attitude")
        assert lines[label].max() == pytest.approx(max(worst, np.finfo(float).eps), abs=1e-15)
    assert lines["Hamiltonian"].max() <= solution.checks.hamiltonian_spread / solution.checks.hamiltonian_size
    assert lines["Hamiltonian"].max() >= 0.5 * solution.checks.hamiltonian_spread / solution.checks.hamiltonian_size


def test_convergence_is_that_of_the_member(solved):
    solution, iterations = solved
    axis = plotting.convergence(iterations)
    gaps = axis.lines[0].get_ydata()
    assert len(gaps) == len(iterations)
    assert gaps[-1] == max(solution.checks.defect, np.finfo(float).eps)
    with pytest.raises(InvalidInputError, match="member 1"):
        plotting.convergence(iterations, member=1)


def test_slopes_are_those_of_the_kit():
    axis = plotting.slopes(Cayley(SO(3)), seeds=[0, 1])
    words = [text.get_text() for text in axis.get_legend().get_texts()]
    assert words[-1] == "slope 2"
    assert all(abs(float(text.split()[-1]) - 2) < 0.1 for text in words[:-1])


def test_an_array_whose_entries_have_names_is_named_by_them():
    plane = Euclidean(2)
    space, names = plane * plane, {"states": (("east", "north"), "velocity"), "controls": ("push", "pull")}
    problem = OptimalControlProblem(space, lambda q, u: (q[1], u), lambda q, u: u @ u / 2, 2, labels=names)
    ends = (np.zeros(2), np.zeros(2)), (np.ones(2), np.zeros(2))
    found = solve(problem, *ends, 1.0, method=Midpoint(Exponential(space)), steps=3)
    panels = plotting.histories(found)
    assert [axis.get_ylabel() for axis in panels] == ["east, north", "velocity", "push, pull"]
    assert [text.get_text() for text in panels[0].get_legend().get_texts()] == ["east", "north"]
    assert join_names(tuple("abcd")) == "a, ..., d"


@pytest.mark.parametrize("record", [None, 1.0, [1, 2], "solution"])
@pytest.mark.parametrize(
    "name", ["histories", "state", "controls", "attitude", "body_axes", "path", "conserved", "multipliers", "energy"]
)
def test_other_records_are_refused(name, record):
    more = [lambda q, p: 0.0] if name == "energy" else []
    with pytest.raises(InvalidInputError, match=r"expected a (Solution|Trajectory)"):
        getattr(plotting, name)(record, *more)


def test_places_that_no_array_has_are_refused(solved):
    solution, _ = solved
    for draw, wrong in ((plotting.state, 2), (plotting.attitude, 1), (plotting.body_axes, 1), (plotting.path, 0)):
        with pytest.raises(InvalidInputError, match="array"):
            draw(solution, wrong)
    with pytest.raises(InvalidInputError, match="names"):
        plotting.histories(solution, Sphere(2))
    with pytest.raises(InvalidInputError, match="OptimalControlProblem or a Manifold"):
        plotting.histories(solution, "problem")
    with pytest.raises(InvalidInputError, match="no controls"):
        plotting.controls(made_by_hand(q=np.zeros((4, 2))))
    with pytest.raises(InvalidInputError, match="must return a number"):
        plotting.energy(made_by_hand(q=np.zeros((4, 2))), lambda q, p: q)
