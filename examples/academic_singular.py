r"""The paper's singular problem

The singular problem of the paper: classified, and integrated on its final constraint manifold.

    \dot x = f(x) + u_1, \quad \dot y = y, \qquad \min \int \tfrac12 (x^2 + y^2 + u_1^2) + x u_1 + y u_2\,dt

:math:`P_f = \{y = 0\}` carries a presymplectic form of rank 2 with kernel :math:`\partial/\partial p_y`;
:math:`u_1 = p_x - x` is determined and :math:`u_2` is gauge. For :math:`f = 0`, :math:`f = x/2` and :math:`f = \sin`
the solutions are known in closed form or to seven digits, and the scheme that the paper prints is the general
machinery to rounding. [Barbero-Linan, Martin de Diego, Presymplectic integrators for optimal control problems via
retraction maps, section 5.1]

    python examples/academic_singular.py [--output examples/output]
"""

import argparse
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import matplotlib as mpl
import numpy as np
from retrax.integrators import OptimalControlProblem, classify, integrate, singular_integrator
from retrax.manifolds import Euclidean
from retrax.retractions import Addition, Midpoint

jax.config.update("jax_enable_x64", True)
mpl.use("Agg")
import matplotlib.pyplot as plt

PLANE = Euclidean(2)
START = jnp.array([0.7, 0.0]), jnp.array([-0.3, 0.2])
COUNTS = np.array([20, 40, 80])
DRIFTS = {"f = 0": (0.0, 0.0), "f = x/2": (0.5, 0.0), "f = sin": (0.0, 1.0)}
# x(1) and p_x(1). The first two from p = p0 e^((1-a)t), x = x0 e^(-(1-a)t) + p0 sinh((1-a)t)/(1-a).
KNOWN = {
    "f = 0": (-0.0950447493, -0.8154845485),
    "f = x/2": (0.1119142785, -0.4946163812),
    "f = sin": (0.3473665, -0.3445070),
}


class Dynamics(eqx.Module):
    """``(f(x) + u1, y)`` with ``f = a x + b sin x``."""

    a: jax.Array
    b: jax.Array

    def __call__(self, q, u):
        return jnp.stack([self.a * q[0] + self.b * jnp.sin(q[0]) + u[0], q[1]])


def cost(q, u):
    """The running cost; it falls without bound along ``y u2`` unless ``y = 0``."""
    return q @ q / 2 + q @ u + u[0] ** 2 / 2


def gauge(t, q, p):
    """The gauge control ``u2``, ours to choose."""
    return jnp.cos(t)


def printed_scheme(a, b, steps):
    """The scheme as the paper prints it, its four equations solved by Newton's method; nodes ``(x, p_x, p_y)``."""
    h = 1 / steps
    nodes = [np.array([START[0][0], *START[1]])]
    for k in range(steps):
        x, p, s = nodes[-1]
        y = np.array([x, p, s, p - x])
        for _ in range(6):
            middle, momentum = (x + y[0]) / 2, (p + y[1]) / 2
            f, slope, bend = a * middle + b * np.sin(middle), a + b * np.cos(middle), -b * np.sin(middle)
            residual = [
                (y[0] - x) / h - f - y[3],
                (y[1] - p) / h + momentum * slope - middle - y[3],
                (y[2] - s) / h + (s + y[2]) / 2 - np.cos((k + 0.5) * h),
                momentum - middle - y[3],
            ]
            jacobian = [
                [1 / h - slope / 2, 0, 0, -1],
                [momentum * bend / 2 - 0.5, 1 / h + slope / 2, 0, -1],
                [0, 0, 1 / h + 0.5, 0],
                [-0.5, 0.5, 0, -1],
            ]
            y = y - np.linalg.solve(jacobian, residual)
        nodes.append(y[:3])
    return np.array(nodes)


def solve_drift(name):
    """The classification, the choice of the integrator, trajectories with each number of steps, and the largest
    difference to the printed scheme."""
    a, b = DRIFTS[name]
    problem = OptimalControlProblem(PLANE, Dynamics(jnp.array(a), jnp.array(b)), cost, 2)
    classification = classify(problem)
    method, choice = singular_integrator(classification, Midpoint(Addition(PLANE)), gauge=gauge)
    paths = [integrate(problem, method, START, 1 / n, int(n)) for n in COUNTS]
    ours = np.column_stack([paths[0].q[:, 0], paths[0].p])
    difference = np.max(np.abs(ours - printed_scheme(a, b, COUNTS[0])))
    return classification, choice, paths, difference


def plot(paths, errors, path):
    """State, costates and controls for ``f = sin``, and the errors against the step."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(11, 4.5), layout="constrained")
    finest = paths[-1]
    for label, values in (("$x$", finest.q[:, 0]), ("$p_x$", finest.p[:, 0]), ("$p_y$", finest.p[:, 1])):
        left.plot(finest.times, values, label=label)
    for i, label in enumerate(("$u_1 = p_x - x$", "$u_2 = \\cos t$ (gauge)")):
        left.plot(finest.stage_times, finest.controls[:, i], "--", label=label)
    left.set_xlabel("time")
    left.set_title("f = sin")
    left.legend()
    for name, error in errors.items():
        right.loglog(1 / COUNTS, error, "o-", label=name)
    right.loglog(1 / COUNTS, 0.1 / COUNTS**2, "k:", label="slope 2")
    right.set_xticks(1 / COUNTS, [f"1/{n}" for n in COUNTS])
    right.minorticks_off()
    right.set_xlabel("step")
    right.set_title("error of $(x, p_x)$ at the end")
    right.legend()
    figure.savefig(path, dpi=150)
    plt.close(figure)


def main(arguments=None):
    """Classify and integrate; returns, by drift, the errors at each step size, and the differences to the printed
    scheme."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--output", type=Path, default=Path(__file__).parent / "output", help="folder of the figures")
    options = parser.parse_args(arguments)
    options.output.mkdir(parents=True, exist_ok=True)

    errors, differences = {}, {}
    for name in DRIFTS:
        classification, choice, paths, differences[name] = solve_drift(name)
        ends = np.array([[path.q[-1, 0], path.p[-1, 0]] for path in paths])
        errors[name] = np.max(np.abs(ends - KNOWN[name]), axis=1)
        extrapolated = ends[-1] + (ends[-1] - ends[-2]) / 3
        print(f"{name:8s} (x, p_x)(1) = ({extrapolated[0]:.8f}, {extrapolated[1]:.8f}), known {KNOWN[name]}")
        print(f"         errors with {COUNTS} steps: {errors[name]}; printed scheme - ours: {differences[name]:.1e}")
    print(f"\n{classification}\n\nintegrator   {choice}")

    path = options.output / "academic_singular.png"
    plot(paths, errors, path)
    print(f"written: {path}")
    return classification, errors, differences


if __name__ == "__main__":
    main()
