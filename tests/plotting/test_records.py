"""Pictures of several records, in degrees, and of controls that stay within their bounds between the stages."""

from dataclasses import replace

import jax.numpy as jnp
import matplotlib as mpl
import numpy as np
import pytest
from retrax import plotting
from retrax.integrators import (
    OptimalControlProblem,
    PhasedSolution,
    Quantities,
    Quantity,
    Solutions,
    load_solution,
    solve,
)
from retrax.manifolds import SO, Euclidean, InvalidInputError, hat
from retrax.named_columns import NamedColumn
from retrax.retractions import Addition, Cayley, Gauss, Midpoint
from scipy.spatial.transform import Rotation

mpl.use("Agg")

LINE = Euclidean(2)
BOUND = 4.5
CART = OptimalControlProblem(
    LINE,
    lambda q, u: jnp.stack([q[1], u[0]]),
    lambda q, u: u @ u / 2,
    1,
    control_bounds=(-BOUND, BOUND),
    labels={"states": ("place", "speed"), "controls": ("force",)},
    units={"states": ("m", "m/s"), "controls": "N", "time": "s"},
)
TURN = OptimalControlProblem(
    SO(3),
    lambda q, u: q @ hat(u),
    lambda q, u: u @ u / 2,
    3,
    control_bounds=(-2.0, 2.0),
    labels={"states": "attitude", "controls": "rate"},
    units={"controls": "rad/s", "time": "s"},
)
END = Rotation.from_rotvec([0.4, 1.0, 0.3]).as_matrix()


@pytest.fixture(scope="module")
def limited():
    """A cart whose force is at its bound at both ends."""
    return solve(CART, np.zeros(2), np.array([1.0, 0.0]), 1.0, method=Gauss(3, Addition(LINE)), steps=5)


@pytest.fixture(scope="module")
def turn():
    """A turn without active bounds."""
    return solve(TURN, np.eye(3), END, 2.0, method=Midpoint(Cayley(SO(3))), steps=6)


def curves(axis):
    """The lines of the axes that are no bounds, as arrays of times and values."""
    return [line.get_xydata() for line in axis.lines if len(line.get_xdata()) > 2]


def words(axis):
    """The names in the legend."""
    return [text.get_text() for text in axis.get_legend().get_texts()]


def with_controls(solution, end, bound=1.0):
    """The solution with controls whose polynomials, lines through two stages, go from 0.2 to this value in each
    step."""
    first, last = (0.5 - np.sqrt(3) / 6, 0.5 + np.sqrt(3) / 6)
    stages = np.array([[0.2 + (end - 0.2) * first], [0.2 + (end - 0.2) * last]])
    force = replace(solution.quantities.controls[0], bounds=((-bound, bound),))
    return replace(
        solution,
        controls=np.tile(stages, (solution.steps, 1)),
        quantities=replace(solution.quantities, controls=(force,)),
    ), stages.max()


@pytest.mark.parametrize("end", [0.9, 0.99, 1.0, 1.01, 1.02, 1.2, 1.3, 1.6])
@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.usual(2)
def test_a_control_is_drawn_beyond_its_bound_only_where_a_stage_is(end, sign, two_stages):
    """A stage at 1.1 of the bound is not hidden, and a polynomial that leaves the bound between the stages is not
    drawn there."""
    record, largest = with_controls(two_stages, end)
    record = replace(record, controls=sign * record.controls)
    ((_, values),) = [curve.T for curve in curves(plotting.controls(record))]
    assert np.max(sign * values) == pytest.approx(min(end, max(1.0, largest)), abs=1e-13)
    inside = np.max(sign * values) <= 1 + 1e-13
    assert inside == (largest <= 1)


@pytest.fixture(scope="module")
def two_stages():
    """A cart, by a method with two stages."""
    return solve(CART, np.zeros(2), np.array([0.3, 0.0]), 1.0, method=Gauss(2, Addition(LINE)), steps=4)


def test_a_force_at_its_bound_is_drawn_at_its_bound_in_every_picture(limited, tmp_path):
    times = np.linspace(0, 1, 1001)
    assert np.max(np.abs(limited(times).controls)) > 1.01 * BOUND, "its polynomials leave the bounds"
    limited.save(tmp_path / "limited.npz")
    read = load_solution(tmp_path / "limited.npz")
    assert read.quantities == limited.quantities == CART.quantities
    for record in (limited, read):
        for axis in (plotting.controls(record), plotting.histories(record)[-1], plotting.optimality(record)[0]):
            ((_, values),) = [curve.T for curve in curves(axis)]
            assert np.max(np.abs(values)) <= BOUND
            assert np.max(values) == pytest.approx(BOUND, rel=1e-6)
            dashed = {line.get_ydata()[0] for line in axis.lines if line.get_linestyle() == "--"}
            assert dashed == {-BOUND, BOUND}
    assert words(plotting.multipliers(limited)) == ["lower bound of u force", "upper bound of u force"]


@pytest.mark.parametrize("bounds", [(-9.0, 9.0), (-1e6, 1e6), (-np.inf, np.inf), (-np.inf, 9.0)])
def test_a_distant_bound_does_not_change_the_scale(bounds, two_stages):
    record, _ = with_controls(two_stages, 0.9)
    without = plotting.controls(replace(record, quantities=CART.quantities.bounded((), ()))).get_ylim()
    force = replace(record.quantities.controls[0], bounds=(bounds,))
    axis = plotting.controls(replace(record, quantities=replace(record.quantities, controls=(force,))))
    assert axis.get_ylim() == without
    dashed = {line.get_ydata()[0] for line in axis.lines if line.get_linestyle() == "--"}
    assert dashed == {bound for bound in bounds if np.isfinite(bound)}


@pytest.mark.parametrize(
    ("unit", "expected"),
    [
        ("rad", "deg"),
        ("rad/s", "deg/s"),
        ("rad s^-2", "deg s^-2"),
        ("", ""),
        ("m", "m"),
        ("radian", "radian"),
        ("rad^2/s", "rad^2/s"),
        ("rad*m", "rad*m"),
        ("mrad", "mrad"),
        ("N m/rad", "N m/rad"),
    ],
)
def test_units_of_angles_become_degrees_with_their_numbers(unit, expected):
    bounds = ((-1.0, 2.0), (-np.inf, 0.5))
    found = NamedColumn("q", ("0", "1"), (unit,), np.array([[1.0, -2.0]]), bounds).in_degrees
    factor = 1 if unit == expected else 180 / np.pi
    assert found.units == (expected,)
    np.testing.assert_allclose(found.values, factor * np.array([[1.0, -2.0]]))
    np.testing.assert_allclose(found.bounds, factor * np.array(bounds))
    mixed = NamedColumn("q", ("a", "b"), ("m", unit), np.array([[1.0, -2.0]])).in_degrees
    np.testing.assert_allclose(mixed.values, [[1.0, -2.0 * factor]])
    assert mixed.units == ("m", expected)


def test_degrees_are_asked_for_by_one_word(turn):
    vector = np.degrees(Rotation.from_matrix(turn.states).as_rotvec())
    rate = np.degrees(turn.controls)
    panels = [
        (plotting.attitude(turn, degrees=True), vector, "attitude, rotation vector [deg]"),
        (plotting.state(turn, 0, degrees=True), vector, "attitude, rotation vector [deg]"),
        (plotting.histories(turn, degrees=True)[0], vector, "attitude, rotation vector [deg]"),
        (turn.plot(degrees=True)[0], vector, "attitude, rotation vector [deg]"),
        (plotting.controls(turn, degrees=True), rate, "rate [deg/s]"),
        (plotting.optimality(turn, degrees=True)[0], rate, "rate [deg/s]"),
    ]
    for axis, expected, title in panels:
        assert axis.get_ylabel() == title
        for k, curve in enumerate(curves(axis)):
            times, values = curve.T
            np.testing.assert_allclose(np.interp(turn.times, times, values)[:6], expected[:6, k], atol=1e-9)
    assert plotting.attitude(turn).get_ylabel() == "attitude, rotation vector [rad]"


def test_the_legend_is_beside_the_curves(turn, limited):
    compared = plotting.histories({"one": turn, "two": turn})
    for axis in (*plotting.histories(turn), plotting.conserved(turn), plotting.multipliers(limited), *compared):
        axis.figure.canvas.draw()
        legend = axis.get_legend().get_window_extent()
        assert legend.x0 >= axis.get_window_extent().x1 - 1, "right of the panel"
        assert legend.x1 <= axis.figure.bbox.x1 + 1, "inside the figure"
    sphere = plotting.body_axes({"one": turn, "two": turn})
    sphere.figure.canvas.draw()
    legend = sphere.get_legend().get_window_extent()
    assert sphere.figure.bbox.y0 <= legend.y0
    assert legend.y1 <= sphere.get_window_extent().y0 + 1, "below the sphere"


@pytest.mark.parametrize("count", range(1, 8))
def test_panels_fill_their_figure(count):
    """Each panel has its place, and no place is left empty."""
    from retrax.plotting.axes import several

    axes = several(None, count)
    specs = [axis.get_subplotspec() for axis in axes]
    rows, columns = specs[0].get_gridspec().get_geometry()
    taken = [(r, c) for spec in specs for r in spec.rowspan for c in spec.colspan]
    assert sorted(taken) == [(r, c) for r in range(rows) for c in range(columns)]
    assert len(axes[0].figure.axes) == count


def test_inactive_inequalities_have_no_panel(turn, limited):
    assert len(plotting.optimality(turn, TURN)) == 2
    assert len(plotting.optimality(limited, CART)) == 3


def test_two_solutions_share_colours_and_have_their_own_lines(turn):
    longer = replace(turn, times=2 * turn.times, stage_times=2 * turn.stage_times)
    (axis, rate) = plotting.histories({"short": turn, "long": longer})
    lines = [line for line in axis.lines if len(line.get_xdata()) > 2]
    assert [line.get_linestyle() for line in lines] == 3 * ["-"] + 3 * ["--"]
    assert [line.get_color() for line in lines[:3]] == [line.get_color() for line in lines[3:]]
    assert [line.get_xdata()[-1] for line in lines] == pytest.approx(3 * [2.0] + 3 * [4.0])
    assert words(axis) == words(rate) == ["x", "y", "z", "short", "long"]
    handles = axis.get_legend().get_lines()
    assert [handle.get_linestyle() for handle in handles[3:]] == ["-", "--"]


def test_records_of_one_number_have_a_colour_each(limited):
    axis = plotting.controls({"a": limited, "b": limited})
    lines = [line for line in axis.lines if len(line.get_xdata()) > 2]
    assert len({line.get_linestyle() for line in lines}) == 2
    assert words(axis)[-2:] == ["a", "b"]


@pytest.mark.parametrize("count", [1, 2, 5, 40])
@pytest.mark.usual(1)
def test_a_batch_is_drawn_with_the_names_of_its_entries_once(count, turn):
    batch = Solutions.of([turn] * count)
    axes = batch.plot()
    assert [len(curves(axis)) for axis in axes] == [3 * count, 3 * count]
    assert words(axes[0]) == ["x", "y", "z"]
    sphere = plotting.body_axes(batch)
    assert words(sphere) == ["body axis x", "body axis y", "body axis z"]


def test_no_record_is_an_error():
    for nothing in ([], {}, ()):
        with pytest.raises(InvalidInputError, match="no record"):
            plotting.histories(nothing)
    with pytest.raises(InvalidInputError, match="expected a Solution, a Trajectory or a ClosedLoop"):
        plotting.histories({"one": 1.0})


def test_phases_follow_each_other_on_the_same_axes(turn):
    """Rotation vectors go on from phase to phase without a jump, beyond half a turn."""
    onward = replace(
        turn,
        states=np.einsum("ij,njk->nik", END, turn.states),
        stage_states=np.einsum("ij,njk->nik", END, turn.stage_states),
    )
    phased = PhasedSolution.of([turn, onward], {}, True, "")
    vector, rate = phased.plot()
    assert len(curves(vector)) == len(curves(rate)) == 3
    times, values = curves(vector)[0].T
    assert times[-1] == pytest.approx(4.0)
    assert np.max(np.abs(np.diff(values))) < 0.1
    for axis in (vector, rate):
        borders = [line.get_xdata()[0] for line in axis.lines if len(set(line.get_xdata())) == 1]
        assert borders == pytest.approx([2.0])
    assert len(plotting.body_axes(phased).lines) == 3 + 3 * 3


def test_phases_with_other_arrays_have_panels_by_their_names(turn):
    other = Quantity("wheel", ("rad/s",), ("0", "1", "2"), "")
    second = replace(turn, quantities=Quantities(turn.quantities.states, (other,), "s"))
    vector, rate, wheel = plotting.histories(PhasedSolution.of([turn, second], {}, True, ""))
    assert [axis.get_ylabel() for axis in (rate, wheel)] == ["rate [rad/s]", "wheel [rad/s]"]
    assert [len(curves(axis)) for axis in (vector, rate, wheel)] == [6, 3, 3]
    first, last = curves(vector)[0], curves(vector)[3]
    assert (first[0, 0], first[-1, 0], last[0, 0], last[-1, 0]) == pytest.approx((0, 2, 2, 4))
    colours = [line.get_color() for line in vector.lines if len(line.get_xdata()) > 2]
    assert colours[:3] == colours[3:]
    assert words(vector) == ["x", "y", "z"]
