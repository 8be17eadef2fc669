"""Every example runs, reaches the numbers that it asserts, and has the form of a page of the gallery."""

import re
import runpy
import sys
from pathlib import Path

import casadi
import matplotlib.pyplot as plt
import numpy as np
import pytest

EXAMPLES = sorted((Path(__file__).parents[1] / "examples").glob("*.py"))
SHORT = {"attitude_slew", "minimum_time", "spherical_pendulum"}  # of the default run
NAMED = [pytest.param(path, id=path.stem, marks=() if path.stem in SHORT else pytest.mark.slow) for path in EXAMPLES]
END = "# sphinx_gallery_start_ignore\n"


@pytest.mark.parametrize("path", NAMED)
def test_an_example_reaches_its_numbers_and_writes_its_figures(path, tmp_path, monkeypatch):
    if path.stem == "robot_arm_urdf":
        pytest.importorskip("frax", reason="the extra bodies is not installed")
    monkeypatch.setattr(sys, "argv", [str(path), "--output", str(tmp_path)])
    plt.switch_backend("agg")
    runpy.run_path(str(path), run_name="__main__")
    plt.close("all")
    assert (tmp_path / f"{path.stem}_1.png").exists()


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_is_a_page_of_cells(path):
    text = path.read_text()
    title, line = re.match(r'r?"""\n(.+)\n(=+)\n\n', text).groups()
    assert len(title) == len(line)
    assert len(title.split()) <= 5
    assert text.count("\n# %%\n") >= 2
    assert "\nassert " in text, "an example compares its numbers with known ones"


def test_the_examples_end_with_the_same_lines():
    assert len({path.read_text().split(END)[1] for path in EXAMPLES}) == 1


@pytest.mark.slow
def test_ipopt_finds_the_reference_of_the_keep_out_cone():
    """With quaternions, the classical Runge-Kutta method, and torques at the nodes and middles of 240 steps."""
    steps, h, limit = 240, 0.25, 8.0
    inertia, sun = np.array([5621.0, 4547.0, 2364.0]), np.array([0.5, 0.866, 0.1]) / np.linalg.norm([0.5, 0.866, 0.1])

    def velocity(x, u):
        q, v, w = x[0], x[1:4], x[4:]
        spin = casadi.vertcat(-casadi.dot(v, w), q * w + casadi.cross(v, w)) / 2
        return casadi.vertcat(spin, (u - casadi.cross(w, inertia * w)) / inertia)

    opti, cost = casadi.Opti(), 0
    x, u = opti.variable(7, steps + 1), opti.variable(3, 2 * steps + 1)
    for k in range(steps):
        a, b, c = (u[:, 2 * k + i] for i in range(3))
        k1 = velocity(x[:, k], a)
        k2 = velocity(x[:, k] + h / 2 * k1, b)
        k3 = velocity(x[:, k] + h / 2 * k2, b)
        k4 = velocity(x[:, k] + h * k3, c)
        opti.subject_to(x[:, k + 1] == x[:, k] + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4))
        cost += h / 12 * (casadi.sumsqr(a) + 4 * casadi.sumsqr(b) + casadi.sumsqr(c))
    for k in range(1, steps):
        a, b, c, d = (x[i, k] for i in range(4))
        axis = casadi.vertcat(a**2 + b**2 - c**2 - d**2, 2 * (b * c + a * d), 2 * (b * d - a * c))
        opti.subject_to(casadi.dot(axis, sun) <= np.cos(np.deg2rad(25)))
    opti.subject_to(opti.bounded(-limit, casadi.vec(u), limit))
    opti.subject_to(x[:, 0] == [1, 0, 0, 0, 0, 0, 0])
    opti.subject_to(x[:, steps] == [0.5, 0, 0, np.sqrt(0.75), 0, 0, 0])
    half = np.linspace(0, np.pi / 3, steps + 1)
    opti.set_initial(x[:4, :], np.stack([np.cos(half), 0 * half, 0.1 * np.sin(3 * half), np.sin(half)]))
    opti.minimize(cost)
    opti.solver("ipopt", {"print_time": False}, {"print_level": 0, "sb": "yes"})
    text = (EXAMPLES[0].parent / "keep_out_cone.py").read_text()
    reference = float(re.search(r"REFERENCE = ([\d.]+)", text)[1])
    assert opti.solve().value(cost) == pytest.approx(reference, rel=1e-7)
