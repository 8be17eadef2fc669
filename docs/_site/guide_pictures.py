"""The pictures of the guides, from the code of their pages: python docs/_site/guide_pictures.py [PAGE ...]."""

import os
import re
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
import retrax as rx
from picture import save
from retrax import plotting
from retrax.retractions import Projection

DOCS = Path(__file__).parents[1]
Names = dict[str, Any]
BLOCK = re.compile(r"^```python\n(.*?)^```$", re.MULTILINE | re.DOTALL)
KIT = re.compile(r"^print\(check_.*\n", re.MULTILINE)  # checks of the conformance kit, which take long


def obstacles(names: Names) -> Any:
    """The ways around a disc, a cap and the cone of the Sun."""
    figure = plt.figure(figsize=(9, 3.2), layout="constrained")
    flat = figure.add_subplot(1, 3, 1)
    flat.plot(*names["around"].q[:, :2].T)
    flat.add_patch(plt.Circle(names["centre"], names["radius"], color="0.8"))
    flat.set(xlabel="x", ylabel="y", title="disc", aspect="equal")
    cap, sun = (figure.add_subplot(1, 3, place, projection="3d") for place in (2, 3))
    plotting.path(names["tour"], ax=cap, cones=[(names["pole"], 0.5)]).set_title("cap of the sphere")
    plotting.body_axes(names["slew"], ax=sun, cones=[(names["sun"], np.deg2rad(25))]).set_title("cone of the Sun")
    cap.view_init(50, -60)
    sun.view_init(25, 60)
    return figure


def minimum_time(names: Names) -> Any:
    """The bang-bang control of the cart, and the control with a singular arc."""
    figure, axes = plt.subplots(2, 2, figsize=(9, 4), sharex="col", layout="constrained")
    plotting.histories(names["moving"], ax=axes[:, 0])
    plotting.histories(names["to_and_fro"], ax=axes[:, 1])
    axes[0, 0].legend(["position", "velocity"])
    axes[0, 0].set_title("bang-bang")
    axes[0, 1].set_title("with a singular arc from 1 to 2")
    return figure


def phases(names: Names) -> Any:
    """Speed and mass of the rocket with two stages."""
    figure, axis = plt.subplots(figsize=(7, 3), layout="constrained")
    plotting.histories(names["rocket"], ax=[axis])
    axis.legend(["speed", "mass"])
    return figure


def integration(names: Names) -> Any:
    """The path of the pendulum on the sphere, and the error of its energy."""
    figure = plt.figure(figsize=(9, 3.2), layout="constrained")
    sphere, flat = figure.add_subplot(1, 2, 1, projection="3d"), figure.add_subplot(1, 2, 2)
    plotting.path(names["path"], problem=names["S2"], ax=sphere)
    plotting.energy(names["path"], names["energy"], ax=flat)
    return figure


def constraints(names: Names) -> Any:
    """Torque and rate of the slew with limits, beside those without."""
    free = rx.solve(
        names["problem"], names["start"], (names["target"], names["at_rest"]), 60.0, method=names["D"], steps=60
    )
    figure, (torque, rate) = plt.subplots(1, 2, figsize=(9, 3), layout="constrained")
    plotting.controls({"limited": names["bounded"], "free": free}, ax=torque)
    torque.get_legend().remove()
    for solution, style, name in ((names["bounded"], "-", "limited"), (free, "--", "free")):
        rate.plot(solution.times, np.linalg.norm(solution.states[1], axis=1), style, color="C0", label=name)
    rate.axhline(names["largest"], color="0.4", linewidth=0.8, linestyle=":")
    torque.set_ylabel("torque [N m]")
    rate.set(xlabel="time", ylabel="body rate [rad/s]")
    rate.legend()
    return figure


def warm_starts(names: Names) -> Any:
    """The two extremals of a half turn, and the first and the last plan of the controller."""
    ends = names["start"], names["half_turn"]
    along = rx.solve(names["problem"], *ends, 60.0, method=names["D"], steps=100)
    figure = plt.figure(figsize=(9, 3.6), layout="constrained")
    sphere, flat = figure.add_subplot(1, 2, 1, projection="3d"), figure.add_subplot(1, 2, 2)
    plotting.body_axes({"default guess": along, "through a point aside": names["flip"]}, ax=sphere)
    for plan, begin, style, name in (
        (names["first"], 0.0, "--", "first plan"),
        (names["plan"], 12.0, "-", "plan at 12 s"),
    ):
        for k in range(3):
            times = begin + plan.stage_times
            flat.plot(times, plan.controls[:, k], style, color=f"C{k}", label=None if k else name)
    flat.set(xlabel="time [s]", ylabel="torque [N m]")
    flat.legend()
    return figure


def boundary_conditions(names: Names) -> Any:
    """The rates with fixed, free and weighted ends, and the boresight that ends along its aim."""
    figure = plt.figure(figsize=(9, 3.6), layout="constrained")
    flat, sphere = figure.add_subplot(1, 2, 1), figure.add_subplot(1, 2, 2, projection="3d")
    for name, words in (
        ("solution", "at rest at both ends"),
        ("passing", "free at the end"),
        ("turning", "free, weighted end"),
    ):
        flat.plot(names[name].times, np.linalg.norm(names[name].states[1], axis=1), label=words)
    flat.set(xlabel="time [s]", ylabel="body rate [rad/s]")
    flat.legend()
    plotting.body_axes(names["pointed"], ax=sphere, cones=[(names["aim"], 0.08)])
    return figure


def singular(names: Names) -> Any:
    """States, costates and the gauge control of the trajectory on P_f."""
    path = names["path"]
    figure, (state, control) = plt.subplots(1, 2, figsize=(9, 3), layout="constrained")
    for values, name in ((path.q[:, 0], "x"), (path.q[:, 1], "y"), (path.p[:, 0], "$p_x$"), (path.p[:, 1], "$p_y$")):
        state.plot(path.times, values, label=name)
    middle = (path.times[1:] + path.times[:-1]) / 2
    for k, name in enumerate(("$u_1$, determined", "$u_2$, gauge")):
        control.plot(middle, path.controls.reshape(len(middle), -1)[:, k], label=name)
    state.set(xlabel="time", ylabel="state and costate")
    control.set(xlabel="time", ylabel="control")
    state.legend()
    control.legend()
    return figure


def dirac(names: Names) -> Any:
    """The path of the particle, and the force of the constraint."""
    path = names["path"]
    figure = plt.figure(figsize=(9, 3.4), layout="constrained")
    space, flat = figure.add_subplot(1, 2, 1, projection="3d"), figure.add_subplot(1, 2, 2)
    plotting.path(path, problem=names["Q"], ax=space)
    flat.plot((path.times[1:] + path.times[:-1]) / 2, path.controls[:, 0])
    flat.set(xlabel="time", ylabel="constraint force")
    return figure


def sweeps(names: Names) -> Any:
    """How cost and peak torque are distributed over the members of the study."""
    figure, axes = plt.subplots(1, 2, figsize=(9, 2.8), sharey=True, layout="constrained")
    found = names["found"]
    for axis, values, name in (
        (axes[0], found.cost, "cost [N$^2$ m$^2$ s]"),
        (axes[1], found.kept["peak torque"], "peak torque [N m]"),
    ):
        axis.hist(values, bins=30)
        axis.axvline(np.median(values), color="0.2", linewidth=1, linestyle="--")
        axis.set_xlabel(name)
    axes[0].set_ylabel("members")
    return figure


def parameter_studies(names: Names) -> Any:
    """The costs of a batch of slews against their angles, and the rates of its members."""
    figure, (cost, rate) = plt.subplots(1, 2, figsize=(9, 2.8), layout="constrained")
    cost.plot(np.rad2deg(names["angles"]), names["many"].cost, "o-", markersize=3)
    cost.set(xlabel="angle of the slew [deg]", ylabel="cost [N$^2$ m$^2$ s]")
    for k, member in enumerate(names["many"]):
        values = np.linalg.norm(member.states[1], axis=1)
        rate.plot(member.times, values, color=plt.cm.viridis(k / len(names["angles"])), linewidth=0.8)
    rate.set(xlabel="time [s]", ylabel="body rate [rad/s]")
    return figure


def accuracy(names: Names) -> Any:
    """The state with two short layers, near each end, and the lengths of the steps."""
    refined = names["refined"]
    figure, axes = plt.subplots(1, 3, figsize=(9, 2.8), layout="constrained")
    for axis, window, title in ((axes[0], (0.0, 5.0), "start"), (axes[1], (9995.0, 10_000.0), "end")):
        times = np.linspace(*window, 400)
        axis.plot(times - window[axis is axes[1]], refined(times).states)
        nodes = (refined.times >= window[0]) & (refined.times <= window[1])
        axis.plot(refined.times[nodes] - window[axis is axes[1]], refined.states[nodes], "o", color="C0", markersize=3)
        axis.set(title=title, ylabel="state", xlabel="time" if axis is axes[0] else "time - 10 000")
    axes[2].semilogy(np.diff(refined.times), "o-", markersize=3)
    axes[2].set(title="mesh", xlabel="step", ylabel="length of the step")
    return figure


def from_casadi(names: Names) -> Any:
    """The slew around the keep-out cone with its torques, and the flight of the quadrotor."""
    figure = plt.figure(figsize=(9, 3.2), layout="constrained")
    sphere, torque = figure.add_subplot(1, 3, 1, projection="3d"), figure.add_subplot(1, 3, 2)
    flight = figure.add_subplot(1, 3, 3, projection="3d")
    plotting.body_axes(names["slew"], ax=sphere, cones=[(names["sun"], names["away"])]).set_title("keep-out cone")
    plotting.controls(names["slew"], ax=torque)
    torque.get_legend().remove()
    torque.set_title("torque within its bounds")
    plotting.path(names["flown"], ax=flight).set_title("flight of the quadrotor")
    return figure


def from_geometry(names: Names) -> Any:
    """The energy error and the spatial momenta of the heavy top."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(9, 2.8), layout="constrained")
    plotting.energy(names["path"], names["top"], ax=left)
    for k in range(3):
        right.plot(names["path"].times, names["momenta"][:, k], label="about " + "xyz"[k])
    right.set(xlabel="time", ylabel="spatial momentum")
    right.legend()
    return figure


def integration_batches(names: Names) -> Any:
    """The paths of a batch of pendulums on the sphere."""
    figure = plt.figure(figsize=(9, 3.6), layout="constrained")
    sphere, flat = figure.add_subplot(1, 2, 1, projection="3d"), figure.add_subplot(1, 2, 2)
    sphere_of = plotting.path(names["one"], problem=names["S2"], ax=sphere)
    heights = np.asarray(names["many"].q[:, :, 2])
    for k, height in enumerate(heights):
        colour = plt.cm.viridis(k / len(heights))
        sphere_of.plot(*np.asarray(names["many"].q[k]).T, color=colour, linewidth=0.7)
        flat.plot(0.05 * np.arange(len(height)), height, color=colour, linewidth=0.9)
    flat.set(xlabel="time", ylabel="height of the pendulum")
    return figure


def pictures(names: Names) -> Any:
    """What a few of the functions of the page draw."""
    figure = plt.figure(figsize=(9, 5), layout="constrained")
    axes = [figure.add_subplot(2, 3, k, projection="3d" if k == 1 else None) for k in range(1, 7)]
    plotting.body_axes(names["solution"], ax=axes[0], cones=[([1.0, 0.0, 1.0], 0.3)]).set_title("body_axes")
    both = {"free": names["solution"], "at most 10 N m": names["bounded"]}
    plotting.attitude(both, ax=axes[1], degrees=True).set_title("attitude")
    plotting.controls(both, ax=axes[2]).set_title("controls")
    plotting.convergence(names["iterations"], ax=axes[3]).set_title("convergence")
    about = (lambda q, p: q[0], lambda q, p: p[0])
    plotting.phase_portrait(names["swings"], about, names=("angle", "momentum"), ax=axes[4]).set_title("phase_portrait")
    plotting.slopes(rx.Cayley(rx.SO(3)), seeds=(0,), ax=axes[5]).set_title("slopes")
    for axis in axes:
        if axis.get_legend():
            axis.get_legend().remove()
    return figure


def surface(axis: Any, x: Any, y: Any, z: Any, zoom: float = 1.25) -> None:
    """A surface as wires, in axes without a frame."""
    axis.plot_wireframe(x, y, z, rcount=24, ccount=36, color="0.8", linewidth=0.4, zorder=0)
    axis.set_box_aspect((np.ptp(x), np.ptp(y), np.ptp(z)), zoom=zoom)
    axis.set_axis_off()


def grid() -> tuple[Any, Any]:
    """Angles of a grid on a sphere: from the pole, and around the axis."""
    return np.meshgrid(np.linspace(0, np.pi, 60), np.linspace(0, 2 * np.pi, 90), indexing="ij")


def manifolds(names: Names) -> Any:
    """A tangent vector of the sphere, and the curves of two retractions along its multiples."""
    sphere, x, v = rx.Sphere(2), np.array([0.0, -0.8, 0.6]), np.array([1.3, 0.3, 0.4])
    figure = plt.figure(figsize=(9, 3.6), layout="constrained")
    axis, flat = figure.add_subplot(1, 2, 1, projection="3d"), figure.add_subplot(1, 2, 2)
    up, around = grid()
    surface(axis, np.sin(up) * np.cos(around), np.sin(up) * np.sin(around), np.cos(up))
    axis.quiver(*x, *v, color="0.2", arrow_length_ratio=0.1)
    axis.text(*(x + 1.1 * v), "x + v", color="0.2")
    shares = np.linspace(0, 1, 60)
    for retraction in (rx.Exponential(sphere), Projection(sphere)):
        points = np.stack([retraction(x, share * v) for share in shares])
        name = type(retraction).__name__.replace("Sphere", "")
        axis.plot(*points[:, :].T)
        axis.plot(*points[-1:].T, "o", color=axis.lines[-1].get_color(), markersize=4)
        lengths = np.linspace(0, 6, 200)
        ends = np.stack([retraction(x, length * v / np.linalg.norm(v)) for length in lengths])
        flat.plot(lengths, np.arccos(np.clip(ends @ x, -1, 1)), label=name)
    flat.set(xlabel="length of the tangent vector", ylabel="distance of R(x, v) from x")
    flat.legend()
    axis.view_init(25, -50)
    return figure


def new_manifold(names: Names) -> Any:
    """The cube with round edges, and the shortest path from the middle of a face to a corner."""
    figure = plt.figure(figsize=(9, 3.2), layout="constrained")
    axis = figure.add_subplot(projection="3d")
    up, around = grid()
    points = np.stack([np.sin(up) * np.cos(around), np.sin(up) * np.sin(around), np.cos(up)])
    surface(axis, *(points / np.sum(points**4, axis=0) ** 0.25))
    plotting.path(names["path"], ax=axis)
    axis.view_init(30, 30)
    axis.set_axis_off()
    return figure


def own_manifold(names: Names) -> Any:
    """The shortest path on the torus, and the circle around Dido's area."""
    figure = plt.figure(figsize=(9, 3.4), layout="constrained")
    axis, flat = figure.add_subplot(1, 2, 1, projection="3d"), figure.add_subplot(1, 2, 2)
    first, second = np.meshgrid(np.linspace(0, 2 * np.pi, 60), np.linspace(0, 2 * np.pi, 60))
    surface(axis, (2 + np.cos(first)) * np.cos(second), (2 + np.cos(first)) * np.sin(second), np.sin(first), zoom=1.35)
    axis.plot(*names["solution"].states.T, color="C3", linewidth=2)
    axis.view_init(35, 10)
    flat.plot(names["dido"].states[:, 0, 1], names["dido"].states[:, 1, 2])
    flat.set(xlabel="x", ylabel="y", aspect="equal", title="Dido's curve around the area 1/2")
    return figure


def receding_horizon(names: Names) -> Any:
    """The pendulum on a cart in closed loop: angle and position, and the force."""
    loop, figure = names["loop"], plt.figure(figsize=(9, 2.8), layout="constrained")
    axis, force = figure.subplots(1, 2)
    axis.plot(loop.t, loop.q[:, 2], label="angle from upright [rad]")
    axis.plot(loop.t, loop.q[:, 0], label="position of the cart [m]")
    axis.set(xlabel="time [s]")
    axis.legend()
    plotting.controls(loop, ax=force).set(xlabel="time [s]", ylabel="force [N]")
    return figure


# What draws the picture of a page, and after which blocks of its code: the first ones, or those in a list.
PAGES: dict[str, tuple[Callable[[Names], Any], int | list[int]]] = {
    "accuracy": (accuracy, [0, 2]),
    "boundary_conditions": (boundary_conditions, 3),
    "constraints": (constraints, 2),
    "dirac": (dirac, 1),
    "from_casadi": (from_casadi, [0, 2, 4]),
    "from_geometry": (from_geometry, 3),
    "integration": (integration, 1),
    "integration_batches": (integration_batches, 4),
    "manifolds": (manifolds, 0),
    "minimum_time": (minimum_time, 4),
    "new_manifold": (new_manifold, 2),
    "obstacles": (obstacles, 3),
    "own_manifold": (own_manifold, [0, 1, 2, 5, 6, 7]),
    "parameter_studies": (parameter_studies, [0, 1, 5]),
    "phases": (phases, 2),
    "pictures": (pictures, 4),
    "receding_horizon": (receding_horizon, 3),
    "singular": (singular, [0, 5]),
    "sweeps": (sweeps, 1),
    "warm_starts": (warm_starts, 6),
}


def main(chosen: list[str]) -> None:
    """Run the code of the pages and write their pictures, ``docs/PAGE.png``."""
    for page in chosen or PAGES:
        draw, wanted = PAGES[page]
        names: Names = {"__name__": page}
        blocks = BLOCK.findall((DOCS / f"{page}.md").read_text())
        os.chdir(tempfile.mkdtemp())  # pages write files
        for place in range(wanted) if isinstance(wanted, int) else wanted:
            exec(KIT.sub("", blocks[place]), names)
        plt.close("all")
        with mpl.rc_context({"font.size": 8, "lines.linewidth": 1.2}):
            save(draw(names), DOCS / f"{page}.png")


if __name__ == "__main__":
    main(sys.argv[1:])
