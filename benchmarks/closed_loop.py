"""A receding horizon loop beside CasADi with FATROP: a small satellite at 10 Hz with noise.

    python benchmarks/closed_loop.py [--samples 200] [--compiler gcc]

Four reaction wheels turn a satellite, with limits of torque and rate, and a cone around the Sun that its camera avoids;
``examples/closed_loop.py`` explains the problem. All sides solve from the same measured state at each sample, one after
the other in one run, each from its own solution before, shifted by the sample time, to the relative tolerance 1e-6 and
without a budget. The compiled controller flies the loop. A horizon of 12 s has 12 steps, short ones first:

- ``compiled``: ``RecedingHorizon.export_c``, compiled with ``-O2 -march=native``; ``python``: the same controller in
  Python. By collocation of order 4, with two controls in a step.
- ``fatrop``: multiple shooting by the Runge-Kutta method of order 4 with quaternions, one control in a step, the same
  cost, and soft constraints in the middle of the steps: fewer unknowns. The fastest of some ``mu_init``.

One JSON line a side: milliseconds, median and worst after the first sample, iterations, ratios to FATROP, failures.
"""

import argparse
import ctypes
import json
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import casadi as ca
import jax
import numpy as np
import retrax as rx
from scipy.spatial.transform import Rotation

jax.config.update("jax_enable_x64", True)
sys.path.insert(0, str(Path(__file__).parents[1]))

from tests.support import satellite  # noqa: E402

STEPS, HORIZON, SAMPLE, TOLERANCE = satellite.STEPS, satellite.HORIZON, satellite.SAMPLE, 1e-6
AXES, CAMERA, CONE, J, RATE = satellite.AXES, satellite.CAMERA, satellite.CONE, satellite.J, satellite.RATE
SOFT, SUN, TORQUE = satellite.SOFT, satellite.SUN, satellite.TORQUE
BARRIERS = 1e-1, 1e-2, 1e-3, 1e-4  # first ones of FATROP
TRIED = 30  # samples of each
COST_UNIT = 100.0  # of the cost that FATROP is given: in units of one its residuals stall at 1e-5


class Compiled:
    """The controller in C."""

    def __init__(self, python, folder, compiler):
        python.export_c(folder / "satellite", "satellite", satellite.START)
        own = folder / "satellite"
        (own / "sizes.c").write_text(
            '#include "satellite_controller.h"\n'
            "unsigned long controller_bytes(void) { return sizeof(satellite_controller); }\n"
            "int last_iterations(const satellite_controller *c) { return c->output.iterations; }\n"
        )
        flags = [
            "-std=c99",
            "-O2",
            "-march=native",
            "-ffp-contract=off",
            "-fno-math-errno",
            "-fno-trapping-math",
            "-shared",
            "-fPIC",
        ]
        sources = ["satellite.c", "satellite_functions.c", "satellite_controller.c", "sizes.c"]
        sources += [str(path) for path in sorted((own / "core").glob("*.c"))]
        flags += ["-DRETRAX_ONE_INSTRUCTION_SET", "-Icore"]
        subprocess.run([compiler, *flags, *sources, "-lm", "-o", "flown.so"], cwd=own, check=True)
        self.library = ctypes.CDLL(str(own / "flown.so"))
        text = (own / "satellite.h").read_text()
        bytes_ = int(text.split("SATELLITE_WORKSPACE_BYTES = ")[1].split(",")[0])
        self.memory, self.room = np.zeros(self.library.controller_bytes() // 8 + 1), np.zeros(bytes_ // 8 + 1)
        self.library.satellite_begin(self._at(self.memory))
        self.iterations, self.failed = 0, 0

    @staticmethod
    def _at(array):
        return ctypes.c_void_p(array.ctypes.data)

    def __call__(self, q, t):
        """The control for a state."""
        state, control = np.concatenate([np.ravel(part) for part in q]), np.zeros(4)
        own = map(self._at, (self.memory, state, control, self.room))
        memory, at, to, room = own
        self.failed += self.library.satellite_step(memory, at, ctypes.c_double(t), to, room) != 0
        self.iterations = self.library.last_iterations(memory)
        return control


class Python:
    """The controller in Python with its figures."""

    def __init__(self, own):
        self.own, self.iterations, self.failed = own, 0, 0

    def __call__(self, q, t):
        """The control for a state."""
        control = self.own(q, t)
        found = self.own.statistics
        self.iterations, self.failed = int(found.iterations[-1]), len(found.failures)
        return control


def product(a, b):
    """The product of quaternions, scalar parts first."""
    return ca.vertcat(a[0] * b[0] - ca.dot(a[1:], b[1:]), a[0] * b[1:] + b[0] * a[1:] + ca.cross(a[1:], b[1:]))


def attitude(q):
    """The rotation matrix of a quaternion."""
    columns = [product(product(q, ca.vertcat(0, e)), ca.vertcat(q[0], -q[1:]))[1:] for e in np.eye(3)]
    return ca.horzcat(*columns)


class Fatrop:
    """The problem in CasADi with FATROP: quaternion, rate and momenta; torques and slacks."""

    def __init__(self, barrier):
        self.times = np.concatenate([[0.0], np.cumsum(HORIZON * STEPS / STEPS.sum())])
        self.table, self.iterations, self.failed = None, 0, 0
        functions = self._functions()
        self._build(*functions, barrier)

    @staticmethod
    def _functions():
        """The step, and the soft constraints."""
        x, v, h = ca.SX.sym("x", 11), ca.SX.sym("v", 6), ca.SX.sym("h")
        goal, axes = ca.DM(satellite.TARGET), ca.DM(AXES)

        def off(x):
            return 3 - ca.trace(ca.mtimes(goal.T, attitude(x[:4])))

        def slope(x):
            w, spin = x[4:7], ca.cross(x[4:7], J * x[4:7] + ca.mtimes(axes, x[7:]))
            cost = 20 * off(x) + 300 * ca.dot(w, w) + ca.dot(v[:4], v[:4]) / 10
            return ca.vertcat(product(x[:4], ca.vertcat(0, w)) / 2, (-ca.mtimes(axes, v[:4]) - spin) / J, v[:4], cost)

        a = slope(x)
        b = slope(x + h / 2 * a[:-1])
        c = slope(x + h / 2 * b[:-1])
        d = slope(x + h * c[:-1])
        moved = h / 6 * (a + 2 * b + 2 * c + d)
        soft = sum(weight * (s + s**2 / 2) for weight, s in zip(SOFT.values(), (v[4], v[5]), strict=True))
        amid = x + h / 2 * a[:-1]
        speed, camera = ca.dot(amid[4:7], amid[4:7]), ca.mtimes(attitude(amid[:4]), CAMERA)
        limits = ca.vertcat(speed / RATE**2 - 1 - v[4], ca.dot(camera, SUN) - np.cos(CONE) - v[5])
        last = 200 * off(x) + 2000 * ca.dot(x[4:7], x[4:7])
        step = ca.Function("step", [x, v, h], [x + moved[:-1], moved[-1] + h * soft, limits])
        return step, ca.Function("last", [x], [last])

    def _build(self, step, last, barrier):
        n, p = len(STEPS), ca.MX.sym("p", 11)
        x, v = [ca.MX.sym(f"x{k}", 11) for k in range(n + 1)], [ca.MX.sym(f"v{k}", 6) for k in range(n)]
        cost, g, equality, lower = last(x[n]), [], [], []
        for k in range(n):
            end, share, limits = step(x[k], v[k], self.times[k + 1] - self.times[k])
            cost += share
            first = [x[0] - p] if k == 0 else []
            g += [x[k + 1] - end, *first, limits]
            equality += [True] * (11 + 11 * len(first)) + [False] * 2
            lower += [0.0] * (11 + 11 * len(first)) + [-np.inf] * 2
        z = ca.vertcat(*(part for pair in zip(x, v, strict=False) for part in pair), x[n])
        options = {
            "print_time": False, "expand": True, "fatrop.print_level": 0, "fatrop.tol": TOLERANCE,
            "error_on_fail": False,
            "fatrop.mu_init": barrier, "structure_detection": "auto", "equality": equality,
        }  # fmt: skip
        self.solver = ca.nlpsol("loop", "fatrop", {"x": z, "f": cost / COST_UNIT, "g": ca.vertcat(*g), "p": p}, options)
        bound = np.concatenate([np.full(11, np.inf), np.full(4, TORQUE), np.full(2, np.inf)])
        floor = np.concatenate([np.full(11, -np.inf), np.full(4, -TORQUE), np.zeros(2)])
        self.bounds = {
            "lbx": np.concatenate([np.tile(floor, n), np.full(11, -np.inf)]),
            "ubx": np.concatenate([np.tile(bound, n), np.full(11, np.inf)]),
            "lbg": np.array(lower), "ubg": np.zeros(len(lower)),
        }  # fmt: skip

    def __call__(self, q, t):
        """The control for a state; the last one of the plan stays where a solve fails."""
        R, w, h = q
        turn = Rotation.from_matrix(R).as_quat()[[3, 0, 1, 2]]
        if self.table is not None and turn @ self.table[0, :4] < 0:
            turn = -turn
        state = np.concatenate([turn, w, h])
        found = self.solver(x0=self._guess(state), p=state, **self.bounds)
        figures = self.solver.stats()
        self.iterations = int(figures["iter_count"])
        self.failed += not figures["success"]
        self.table = np.vstack([np.asarray(found["x"]).ravel()[:-11].reshape(len(STEPS), 17), np.zeros(17)])
        self.table[-1, :11] = np.asarray(found["x"]).ravel()[-11:]
        self.table[-1, 11:] = self.table[-2, 11:]
        return self.table[0, 11:15]

    def _guess(self, state):
        """The solution before, shifted by a sample."""
        if self.table is None:
            return np.concatenate([np.tile(np.concatenate([state, np.zeros(6)]), len(STEPS)), state])
        at = np.minimum(self.times + SAMPLE, HORIZON)
        shifted = np.stack([np.interp(at, self.times, column) for column in self.table.T], axis=1)
        return shifted.ravel()[:-6]


def flown(sides, samples):
    """Seconds, iterations and controls of each side at each sample; the first side flies."""
    seconds = {name: [] for name in sides}
    iterations, controls = {name: [] for name in sides}, {name: [] for name in sides}

    def fly(q, t):
        for name, side in sides.items():
            began = time.perf_counter()
            control = side(q, t)
            seconds[name].append(time.perf_counter() - began)
            iterations[name].append(side.iterations)
            controls[name].append(control)
        return controls[next(iter(sides))][-1]

    noise = {"parameters": satellite.ripple, "measure": satellite.measure}
    rx.simulate(satellite.plant(), fly, satellite.START, samples * SAMPLE, SAMPLE, **noise)
    return seconds, iterations, controls


def main():
    """Print the figures of all sides."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--samples", type=int, default=200)
    parser.add_argument("--compiler", default="gcc")
    given = parser.parse_args()
    tried = {barrier: Fatrop(barrier) for barrier in BARRIERS}
    medians = {name: statistics.median(own[1:]) for name, own in flown(tried, TRIED)[0].items()}
    best = min(medians, key=medians.get)
    folder = Path(tempfile.mkdtemp())
    try:
        python = satellite.controller(max_iterations=None, tolerance=TOLERANCE)
        sides = {"compiled": Compiled(python, folder, given.compiler), "python": Python(python), "fatrop": Fatrop(best)}
        seconds, iterations, controls = flown(sides, given.samples)
    finally:
        shutil.rmtree(folder)
    ours = np.array(controls["compiled"])
    peer = statistics.median(seconds["fatrop"][1:]), max(seconds["fatrop"][1:])
    for name, side in sides.items():
        own = statistics.median(seconds[name][1:]), max(seconds[name][1:])
        row = {
            "side": name, "samples": given.samples, "median_ms": 1e3 * own[0], "worst_ms": 1e3 * own[1],
            "ratio": own[0] / peer[0], "ratio_of_worst": own[1] / peer[1],
            "iterations": statistics.median(iterations[name][1:]), "most": max(iterations[name][1:]),
            "failures": side.failed, "apart": float(np.abs(np.array(controls[name]) - ours).max() / TORQUE),
        }  # fmt: skip
        print(json.dumps(row | ({"mu_init": best} if name == "fatrop" else {})))


if __name__ == "__main__":
    main()
