"""Pictures in space: paths, the axes of bodies, and rotation vectors."""

import numpy as np
import pytest
from matplotlib import pyplot as plt
from mpl_toolkits.mplot3d.proj3d import proj_transform
from retrax import plotting
from retrax.manifolds import SE, SO, Euclidean, InvalidInputError
from retrax.named_columns import rotation_vectors, rotations, view
from scipy.spatial.transform import Rotation

from .test_plotting import made_by_hand, poses

pytestmark = pytest.mark.usefixtures("traced_once")


@pytest.mark.parametrize("step", np.linspace(-3.1, 3.1, 14))
def test_rotation_vectors_turn_on_without_a_jump(step):
    angles = step * np.arange(20) + 0.3
    axis = np.array([1.0, -2.0, 2.0]) / 3
    matrices = Rotation.from_rotvec(angles[:, None] * axis).as_matrix()
    found = rotation_vectors(matrices)
    # The axis points to the first vector's side, and every further angle is known up to that only.
    np.testing.assert_allclose(found, angles[:, None] * axis, atol=1e-7)
    np.testing.assert_allclose(Rotation.from_rotvec(found).as_matrix(), matrices, atol=1e-12)


def test_a_body_at_rest_has_rotation_vectors_of_zero():
    np.testing.assert_array_equal(rotation_vectors(np.broadcast_to(np.eye(3), (4, 3, 3))), np.zeros((4, 3)))


@pytest.mark.parametrize("n", [2, 3])
def test_paths_of_poses_are_their_positions(n):
    record = made_by_hand(q=poses(n))
    axis = plotting.path(record, problem=SE(n), frames=3)
    line = axis.lines[0]
    drawn = np.stack(line.get_data_3d() if n == 3 else line.get_data(), axis=1)
    np.testing.assert_array_equal(drawn, poses(n)[:, :n, n])
    assert len(axis.lines) >= 3 + 3 * n, "the path, its ends, and the axes of three frames"
    names = [axis.get_ylabel() for axis in plotting.histories(record, SE(n))]
    assert names == (["q, angle [rad]", "q, position"] if n == 2 else ["q, rotation vector [rad]", "q, position"])
    with pytest.raises(InvalidInputError, match="unknown"):
        plotting.body_axes(record)
    if n == 3:
        assert rotations(view(record, SE(3))).shape == (9, 3, 3)


@pytest.mark.parametrize("lengths", [(1, 1, 1), (5, 1, 0.02), (0.02, 1, 5), (1, 0.02, 0.02)])
def test_the_three_axes_of_a_path_in_space_are_named_within_the_figure(lengths):
    angles = np.linspace(0, 6, 40)
    points = np.stack([np.cos(angles), np.sin(angles), angles / 3], axis=1) * lengths
    axis = plotting.path(made_by_hand(q=points), problem=Euclidean(3))
    axis.figure.canvas.draw()
    for name in "xyz":
        side = getattr(axis, f"{name}axis")
        assert side.label.get_text() == name
        drawn = side.label.get_window_extent()
        assert np.all(axis.figure.bbox.min <= drawn.min)
        assert np.all(drawn.max <= axis.figure.bbox.max)
        ticks = [tick.label1.get_window_extent() for tick in side.get_major_ticks() if tick.label1.get_visible()]
        assert not any(drawn.overlaps(tick) for tick in ticks)
    scales = [np.ptp(getattr(axis, f"get_{name}lim")()) for name in "xyz"] / axis._box_aspect
    np.testing.assert_allclose(scales, scales[0])


def test_the_end_of_a_body_axis_is_seen_where_another_one_starts():
    turn = Rotation.from_rotvec(np.linspace(0, np.pi / 2, 9)[:, None] * [0, 0, 1]).as_matrix()
    axis = plotting.body_axes(made_by_hand(q=turn), problem=SO(3))
    dots = [line for line in axis.lines if line.get_marker() == "o"]
    starts = [dot for dot in dots if dot.get_markerfacecolor() == "white"]
    ends = [dot for dot in dots if dot.get_markerfacecolor() != "white"]
    np.testing.assert_allclose(ends[0].get_data_3d(), starts[1].get_data_3d(), atol=1e-15)
    curves = [line for line in axis.lines if line not in dots]
    assert max(line.zorder for line in curves) < min(dot.zorder for dot in starts)
    assert max(dot.zorder for dot in starts) < min(dot.zorder for dot in ends)
    assert max(dot.get_markersize() for dot in ends) < min(dot.get_markersize() for dot in starts)


@pytest.mark.parametrize("size", [(6.0, 6.0), (9.0, 3.0), (3.0, 7.0)])
def test_a_path_in_space_fills_wide_and_narrow_figures(size):
    points = np.linspace(0, 1, 11)[:, None] * [1.0, 0.4, 0.3]
    figure = plt.figure(figsize=size, layout="constrained")
    axis = plotting.path(made_by_hand(q=points), problem=Euclidean(3), ax=figure.add_subplot(projection="3d"))
    figure.canvas.draw()
    sides = [getattr(axis, f"get_{name}lim")() for name in "xyz"]
    corners = np.stack(np.meshgrid(*sides, indexing="ij")).reshape(3, -1)
    drawn = np.ptp(axis.transData.transform(np.transpose(proj_transform(*corners, axis.get_proj())[:2])), axis=0)
    assert 0.45 < np.max(drawn / figure.bbox.size) < 1
    assert not any(line.get_clip_on() for line in axis.lines)
