"""The unit sphere with the inertial axes, cones, and curves that are faint where they are behind it."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from mpl_toolkits.mplot3d.art3d import Line3D, Poly3DCollection

from .marks import circle

FAINT = 0.25  # opacity behind the sphere
START, REACH, NAMED = 1e-3, 1.25, 1.36  # of the inertial axes, and places of their names
GREY = "0.35"


class OnSphere(Line3D):
    """A line of Matplotlib on the unit sphere, faint where it is behind the sphere in the view of its axes."""

    def draw(self, renderer: Any) -> None:
        """Draw the part behind the sphere, then the part in front."""
        points, alpha = np.array(self.get_data_3d(), float), self.get_alpha()
        is_behind = behind(self.axes, points)
        for part, shade in ((is_behind, FAINT), (~is_behind, 1.0)):
            # With the next point of the other part, so that no gap is left.
            drawn = part | np.append(False, part[:-1])
            self.set_data_3d(*np.where(drawn, points, np.nan))
            self.set_alpha(shade * (1.0 if alpha is None else alpha))
            super().draw(renderer)
        self.set_data_3d(*points)
        self.set_alpha(alpha)


def behind(axis: Any, points: np.ndarray) -> np.ndarray:
    """Whether points, shape ``(3, N)``, are on the far half of the unit sphere in the view of the axes."""
    up, around = np.deg2rad([axis.elev, axis.azim])
    towards = np.array([np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up)])
    return towards @ points < 0


def add_sphere(axis: Any, cones: Sequence[tuple[np.ndarray, float]]) -> None:
    """The sphere as wires, the inertial axes, and cones, of which each meets the sphere in a circle."""
    axis.computed_zorder = False  # else wires are drawn over curves that lie on them
    wires(axis, np.zeros(3), 1.0, color="0.88", zorder=0)
    for name, end in zip("xyz", np.eye(3), strict=True):
        plot(axis, *np.outer(end, [START, REACH]), color=GREY, linewidth=0.9, zorder=1)
        axis.text(*(NAMED * end), name, color=GREY, ha="center", va="center")
    for direction, half_angle in cones:
        rim = circle(direction, half_angle)
        axis.add_collection3d(Poly3DCollection([rim.T], facecolor="0.5", alpha=0.2, zorder=1))
        plot(axis, *rim, color="0.2", linewidth=1.2, zorder=1)
    axis.set(xlim=(-1, 1), ylim=(-1, 1), zlim=(-1, 1))
    axis.set_box_aspect((1, 1, 1), zoom=1.3)
    axis.set_axis_off()


def plot(axis: Any, *points: np.ndarray, **style: Any) -> list[OnSphere]:
    """Add a line on the sphere, as ``plot`` of the axes does."""
    line = OnSphere(*points, **style)
    axis.add_line(line)
    return [line]


def wires(axis: Any, centre: np.ndarray, radius: float, **style: Any) -> None:
    """A ball as wires."""
    polar, azimuth = np.mgrid[0 : np.pi : 19j, 0 : 2 * np.pi : 37j]
    ball = np.stack([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)])
    axis.plot_wireframe(*(centre[:, None, None] + radius * ball), linewidth=0.5, **style)
