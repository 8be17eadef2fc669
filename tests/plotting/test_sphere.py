"""The sphere of directions has inertial axes, cones, and curves that are faint behind it; paths have obstacles."""

import jax.numpy as jnp
import matplotlib as mpl
import numpy as np
import pytest
from mpl_toolkits.mplot3d.art3d import Line3D
from mpl_toolkits.mplot3d.proj3d import proj_transform
from retrax import plotting
from retrax.integrators import Result, Trajectory
from retrax.manifolds import SO, Euclidean, InvalidInputError, Sphere
from retrax.plotting.sphere import FAINT, behind
from scipy.spatial.transform import Rotation

mpl.use("Agg")

ANGLES = np.linspace(0, 2 * np.pi, 73)[:-1]
EQUATOR = np.stack([np.cos(ANGLES), np.sin(ANGLES), 0 * ANGLES], axis=1)
TURNS = Rotation.from_rotvec(ANGLES[:, None] * [0.0, 0.0, 1.0]).as_matrix()


def record(q):
    """A trajectory with these states and zero covectors."""
    t, q = jnp.linspace(0.0, 1.0, len(q)), jnp.asarray(q)
    return Trajectory(t, q, 0 * q, None, t[1:], Result.successful, jnp.asarray(-1))


@pytest.mark.parametrize("elevation", [-60, 0, 30])
@pytest.mark.parametrize("azimuth", [-60, 0, 45, 135, 270])
@pytest.mark.usual(4)
def test_what_is_behind_the_sphere_is_farther_than_its_centre(elevation, azimuth):
    """As the projection of Matplotlib has it, in a view from far away."""
    axis = plotting.path(record(EQUATOR), problem=Sphere(2))
    axis.view_init(elevation, azimuth)
    axis.set_proj_type("ortho")
    axis.figure.canvas.draw()
    points = np.random.default_rng(0).normal(size=(3, 200))
    points /= np.linalg.norm(points, axis=0)
    depth = np.array(proj_transform(*points, axis.get_proj())[2])
    centre = proj_transform(0.0, 0.0, 0.0, axis.get_proj())[2]
    nearer = proj_transform(*axis_towards(axis), axis.get_proj())[2]
    is_far = (depth - centre) * (nearer - centre) < 0
    np.testing.assert_array_equal(behind(axis, points), is_far)


def axis_towards(axis):
    """The direction in which the viewer is."""
    up, around = np.deg2rad([axis.elev, axis.azim])
    return np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up)


@pytest.mark.parametrize("azimuth", [3, 93, 201])
def test_a_curve_is_drawn_faint_behind_the_sphere_and_keeps_its_numbers(azimuth, monkeypatch):
    axis = plotting.path(record(EQUATOR), problem=Sphere(2))
    axis.view_init(10, azimuth)
    (line,) = [line for line in axis.lines if len(line.get_data_3d()[0]) == len(EQUATOR)]
    drawn, draw = [], Line3D.draw

    def kept(self, renderer):
        if self is line:
            drawn.append((np.array(self.get_data_3d()), self.get_alpha()))
        draw(self, renderer)

    monkeypatch.setattr(Line3D, "draw", kept)
    axis.figure.canvas.draw()
    assert {alpha for _, alpha in drawn} == {FAINT, 1.0}
    is_behind = np.cos(ANGLES - np.deg2rad(azimuth)) < -1e-12
    for points, alpha in drawn:
        shown = np.isfinite(points[0])
        assert np.all(shown[is_behind] if alpha == FAINT else shown[~is_behind])
        assert np.sum(shown) <= np.sum(is_behind if alpha == FAINT else ~is_behind) + 2
    np.testing.assert_array_equal(line.get_data_3d(), EQUATOR.T)
    assert line.get_alpha() is None


def test_the_inertial_axes_are_named():
    for axis in (plotting.body_axes(record(TURNS), problem=SO(3)), plotting.path(record(EQUATOR), problem=Sphere(2))):
        axis.figure.canvas.draw()
        names = {text.get_text(): text for text in axis.texts}
        assert set(names) == {"x", "y", "z"}
        box, margin = axis.figure.bbox, 8  # half of a letter
        for text in names.values():
            place = axis.transData.transform(proj_transform(*text.get_position_3d(), axis.get_proj())[:2])
            assert np.all(box.min + margin <= place)
            assert np.all(place <= box.max - margin)
        lines = [np.array(line.get_data_3d()) for line in axis.lines if len(line.get_data_3d()[0]) == 2]
        np.testing.assert_allclose([line[:, -1] / np.linalg.norm(line[:, -1]) for line in lines], np.eye(3))
        assert all(np.linalg.norm(line[:, -1]) > 1 for line in lines)


@pytest.mark.parametrize("half_angle", [0.1, np.pi / 3, np.pi / 2, 2.5])
@pytest.mark.parametrize("direction", [(0, 0, 2.0), (1.0, -1.0, 0.5), (-3.0, 0, 0)])
def test_a_cone_meets_the_sphere_at_its_half_angle(direction, half_angle):
    axis = plotting.body_axes(record(TURNS), problem=SO(3), cones=[(direction, half_angle)])
    (rim,) = [np.array(line.get_data_3d()) for line in axis.lines if len(line.get_data_3d()[0]) == 100]
    np.testing.assert_allclose(np.linalg.norm(rim, axis=0), 1, atol=1e-14)
    unit = np.array(direction) / np.linalg.norm(direction)
    np.testing.assert_allclose(np.arccos(unit @ rim), half_angle, atol=1e-7)


@pytest.mark.parametrize("n", [2, 3])
def test_obstacles_are_drawn_where_they_are(n):
    centre = np.arange(1.0, n + 1)
    axis = plotting.path(record(EQUATOR[:, :n]), problem=Euclidean(n), obstacles=[(centre, 0.5)])
    axis.figure.canvas.draw()
    if n == 2:
        (disc,) = axis.patches
        assert (tuple(disc.center), disc.radius) == ((1.0, 2.0), 0.5)
    else:
        (ball,) = axis.collections
        points = np.concatenate(ball._segments3d)
        np.testing.assert_allclose(np.linalg.norm(points - centre, axis=1), 0.5, atol=1e-14)
    assert axis.get_ylim()[1] > 2.4


@pytest.mark.parametrize(
    "wrong", [1, [1], [(1, 2)], [([1.0, 0, 0], -1)], [([1.0, np.nan, 0], 1)], [([1.0], 1)]], ids=repr
)
def test_other_cones_and_obstacles_are_errors(wrong):
    with pytest.raises(InvalidInputError, match="cones must be pairs"):
        plotting.body_axes(record(TURNS), problem=SO(3), cones=wrong)
    with pytest.raises(InvalidInputError, match="obstacles must be pairs"):
        plotting.path(record(EQUATOR), problem=Euclidean(3), obstacles=wrong)


def test_a_cone_in_degrees_is_an_error():
    with pytest.raises(InvalidInputError, match="half-angle below pi"):
        plotting.body_axes(record(TURNS), problem=SO(3), cones=[([0.0, 0, 1], 30.0)])
    with pytest.raises(InvalidInputError, match="not zero"):
        plotting.path(record(EQUATOR), problem=Sphere(2), cones=[([0.0, 0, 0], 0.3)])


def test_two_paths_have_colours_and_names_and_paths_in_other_spaces_are_errors():
    half, third = record(EQUATOR[:36]), record(EQUATOR[:24])
    axis = plotting.path({"half": half, "third": third}, problem=Sphere(2))
    assert [text.get_text() for text in axis.get_legend().get_texts()] == ["half", "third"]
    lines = {len(line.get_data_3d()[0]): line for line in axis.lines if len(line.get_data_3d()[0]) > 2}
    assert lines[36].get_color() != lines[24].get_color()
    with pytest.raises(InvalidInputError, match="different spaces"):
        plotting.path([record(EQUATOR[:, :2]), half])
