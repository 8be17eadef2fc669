r"""Abnormal extremals

Abnormal extremals: the line :math:`x = 0` of the Martinet distribution, which is also normal in a flat metric, and
not in a bent one.

    \dot q = u_1 X_1 + u_2 X_2, \qquad X_1 = \partial_x, \qquad
    X_2 = \frac{\partial_y + \frac{x^2}{2}\,\partial_z}{1 + \epsilon x}, \qquad
    \text{cost } \tfrac12 (u_1^2 + u_2^2)

Abnormal extremals do not see the metric. ``classify`` finds :math:`p_1 = 0`, :math:`p_2 + p_3 x^2/2 = 0` and then
:math:`x u_1 = x u_2 = 0`, whose solutions are not one manifold: curves that rest (:math:`u = 0`) at any :math:`x`,
and the surface :math:`x = 0` with :math:`\omega_f` of rank 2, whose kernel :math:`\partial_y` is the direction of the
abnormal line; the free control :math:`u_2` is its speed. The two pieces cross where :math:`x = 0` and :math:`u = 0`:
there equations are irregular, and the numeric algorithm counts the starts that come to it but reads no ranks, while
the symbolic one finds it inside both pieces. All are cones: with :math:`p` also :math:`c p` is an extremal, and
:math:`p = 0` is excluded. The piece with the lines is chosen, and one of them integrated on it.

In the flat case (:math:`\epsilon = 0`) the normal geodesics are Jacobi's elliptic functions, and the line is a
geodesic too, for every :math:`p_3`. Otherwise :math:`x = 0` is no normal extremal: those that start along it turn
back at :math:`x = 2\epsilon/p_3`, where their velocity is along :math:`\partial_y` again:
:math:`1 + p_3 x^2/2 = 1 + \epsilon x`. The line is their limit as :math:`p_3` grows, with :math:`p/\lvert p\rvert`
abnormal. It is shortest between points near enough nevertheless [Liu, Sussmann, Memoirs of the AMS 564, 1995, where
abnormal extremals of this kind are treated; Agrachev, Bonnard, Chyba, Kupka, ESAIM: COCV 2, 1997, for the flat case].

    python examples/abnormal_extremals.py [--front 80] [--output examples/output]
"""

import argparse
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import matplotlib as mpl
import numpy as np
from retrax.integrators import SUZUKI, Composition, OptimalControlProblem, PresymplecticIntegrator, integrate
from retrax.integrators.singular import classify, singular_integrator
from retrax.manifolds import Euclidean
from retrax.retractions import Addition, CotangentLift, Midpoint
from scipy.special import ellipe, ellipeinc, ellipj, ellipk

jax.config.update("jax_enable_x64", True)
mpl.use("Agg")
import matplotlib.pyplot as plt

Q = Euclidean(3)
MIDPOINT = PresymplecticIntegrator(CotangentLift(Midpoint(Addition(Q))))
METHODS = {2: MIDPOINT, 4: Composition(MIDPOINT, SUZUKI)}
EPSILON = 0.5
ANGLE, P3, HORIZON = 1.2, 4.0, 5.0  # of the geodesic that is compared with its closed form


class Martinet(eqx.Module):
    """The velocity ``u_1 X_1 + u_2 X_2``."""

    epsilon: float | jax.Array

    def __call__(self, q, u):
        """At ``q = (x, y, z)``."""
        along = u[1] / (1 + self.epsilon * q[0])
        return jnp.stack([u[0], along, along * q[0] ** 2 / 2])


def energy(q, u):
    """Half the square of the speed."""
    return u @ u / 2


def martinet(epsilon, abnormal=False):
    """The problem of the shortest horizontal curves."""
    return OptimalControlProblem(Q, Martinet(epsilon), energy, 2, abnormal=abnormal)


def geodesics(epsilon, angle, p3, horizon, steps, order=2):
    """Nodes of the normal extremals from 0 at unit speed, ``angle`` from the line, one per entry of ``angle`` and
    ``p3``."""
    costates = jnp.stack(jnp.broadcast_arrays(jnp.sin(angle), jnp.cos(angle), p3), axis=-1).reshape(-1, 3)
    problem, q0 = martinet(jnp.asarray(epsilon)), jnp.zeros(3)

    def path(p0):
        return integrate(problem, METHODS[order], (q0, p0), horizon / steps, steps).q

    return np.asarray(jax.jit(jax.vmap(path))(costates))


def flat_geodesic(t, angle, p3):
    """The same in closed form, for the flat metric and ``p3 > 0``: the pendulum ``angle'' = -p3 sin(angle)``, started
    at rest."""
    rate, m = np.sqrt(p3), np.sin(angle / 2) ** 2
    quarter = ellipk(m)
    s = rate * t - quarter

    def primitives(s):
        """Of ``sn^2`` and ``sn^4``."""
        sn, cn, dn, amplitude = ellipj(s, m)
        square = (s - ellipeinc(amplitude, m)) / m
        return square, (sn * cn * dn - s + 2 * (1 + m) * square) / (3 * m)

    square, fourth = (a - b for a, b in zip(primitives(s), primitives(-quarter), strict=True))
    x = 2 * np.sin(angle / 2) / rate * ellipj(s, m)[1]
    z = 2 * m / rate**3 * (rate * t - (1 + 2 * m) * square + 2 * m * fourth)
    return np.stack([x, t - 2 * m / rate * square, z], axis=-1)


def returning_height(m):
    """``z`` where a flat geodesic is back at ``x = 0``, per ``2 m / p3^(3/2)`` and quarter period, ``m =
    sin(angle/2)^2``."""
    quarter = ellipk(m)
    square = (quarter - ellipe(m)) / m
    return quarter - (1 + 2 * m) * square + 2 * (2 * (1 + m) * square - quarter) / 3


def print_classification():
    """The pieces of the abnormal extremals for both metrics, exactly and from random points."""
    exact = [classify(martinet(epsilon, abnormal=True), symbolic=True) for epsilon in (0.0, EPSILON)]
    numeric = [classify(martinet(epsilon, abnormal=True)) for epsilon in (0.0, EPSILON)]
    for epsilon, found in zip((0.0, EPSILON), exact, strict=True):
        print(f"\nabnormal extremals, epsilon = {epsilon}\n{found}")
    for epsilon, found in zip((0.0, EPSILON), numeric, strict=True):
        print(f"\nthe same from random points, epsilon = {epsilon}\n{found}")
    return exact, numeric


def abnormal_line(found):
    """An abnormal line at unit speed, integrated on the piece of ``P_f`` that leaves one control free: its nodes."""
    lines = found.choose([stratum.free_controls for stratum in found.strata].index(1))
    method, choice = singular_integrator(lines, Midpoint(Addition(Q)), gauge=lambda t, q, p: jnp.ones(1))
    print(f"\non that piece {choice}")
    start = lines.manifold.nearby((jnp.zeros(3), jnp.array([0.0, 0.0, 1.0])))
    return np.asarray(integrate(found.problem, method, start, 0.1, 10).q)


def front(epsilon, count):
    """Where the geodesics of length 1 and least ``|p3|``, by angle and sign, end on the plane x = 0: points ``(y, z)``.

    Interpolated in ``sqrt(|p3|)``; NaN where none of them does.
    """
    angles, rates = np.linspace(-3.1, 3.1, 64), np.linspace(0.5, 25.0, count)
    angle, rate, sign = (grid.reshape(-1) for grid in np.meshgrid(angles, rates, [-1.0, 1.0], indexing="ij"))
    ends = geodesics(epsilon, angle, sign * rate**2, 1.0, 100)[:, -1].reshape(len(angles), count, 2, 3)
    below, above = ends[:, :-1], ends[:, 1:]
    crossing = below[..., :1] * above[..., :1] < 0
    part = below[..., :1] / (below[..., :1] - above[..., :1])
    first = np.argmax(crossing, axis=1, keepdims=True)
    points = np.where(crossing, (1 - part) * below + part * above, np.nan)
    return np.take_along_axis(points, first, axis=1)[..., 1:].reshape(-1, 2)


def plot(paths, leaving, fronts, path):
    """Geodesics beside their closed form, normal extremals that leave the line, and the wave fronts."""
    figure, axes = plt.subplots(1, 3, figsize=(15, 4.6), layout="constrained")
    t = np.linspace(0, HORIZON, 400)
    for angle, nodes in paths.items():
        exact = flat_geodesic(t, angle, P3)
        (line,) = axes[0].plot(exact[:, 1], exact[:, 0], linewidth=1, label=f"angle {angle}")
        axes[0].plot(nodes[::4, 1], nodes[::4, 0], ".", color=line.get_color(), markersize=4)
    axes[0].set_title(f"flat geodesics, $p_3 = {P3:g}$: closed form and steps (dots)")
    for p3, nodes in leaving.items():
        axes[1].plot(nodes[:, 1], nodes[:, 0], linewidth=1, label=f"$p_3 = {p3:g}$")
    axes[1].set_title(rf"normal extremals along the line, $\epsilon = {EPSILON}$")
    for axis in axes[:2]:
        axis.axhline(0, color="k", linewidth=2, label="abnormal line")
        axis.set_xlabel("y")
        axis.set_ylabel("x")
        axis.legend(fontsize=8)
    for epsilon, points in fronts.items():
        axes[2].plot(points[:, 0], points[:, 1], "o", markersize=3.5, label=rf"$\epsilon = {epsilon}$")
    axes[2].plot([1, -1], [0, 0], "k*", label="ends of the abnormal line")
    axes[2].set(xlim=(-1.05, 1.05), ylim=(-0.045, 0.045), xlabel="y", ylabel="z")
    axes[2].set_title("geodesics of length 1 that end at x = 0, least $|p_3|$", fontsize="medium")
    axes[2].legend(fontsize=8)
    figure.savefig(path, dpi=150)
    plt.close(figure)


def main(arguments=None):
    """Classify, compare, plot; returns what is printed: classifications, errors by order and steps, departures from the
    line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--front", type=int, default=80, help="values of p3 that the wave fronts are drawn from")
    parser.add_argument("--output", type=Path, default=Path(__file__).parent / "output", help="folder of the figures")
    options = parser.parse_args(arguments)
    options.output.mkdir(parents=True, exist_ok=True)

    classified = print_classification()
    line = abnormal_line(classified[1][1])
    print(f"an abnormal line of length 1 ends at {line[-1]}\n")
    errors = {}
    angles = np.array([ANGLE, 0.5, 2.2, 3.0])
    exact = flat_geodesic(HORIZON, ANGLE, P3)
    for order in METHODS:
        for steps in (100, 200):
            nodes = geodesics(0.0, angles, P3, HORIZON, steps, order)
            errors[order, steps] = float(np.max(np.abs(nodes[0, -1] - exact)))
        measured = np.log2(errors[order, 100] / errors[order, 200])
        print(
            f"flat geodesic of length {HORIZON:g}: error {errors[order, 200]:.1e} after 200 steps, of order "
            f"{measured:.2f}"
        )
    costates = np.array([25.0, 100.0, 400.0, 1600.0])
    straight, leaving = (geodesics(epsilon, 0.0, costates, 1.0, 400) for epsilon in (0.0, EPSILON))
    print(f"epsilon = 0: the line is normal, with every p3: largest |x| {np.max(np.abs(straight[..., 0])):.1e}")
    departures = costates * np.max(np.abs(leaving[..., 0]), axis=1)
    listed = "  ".join(f"{departure:.5f}" for departure in departures)
    print(
        f"epsilon = {EPSILON}: it is not; p3 times the largest |x|, exactly {2 * EPSILON}, at p3 = {costates}: {listed}"
    )
    heights = returning_height(np.linspace(1e-6, 1 - 1e-12, 10_001))
    print(
        f"flat geodesics that come back to x = 0 have z > 0 there (at least {heights.min():.4f} in its units), so that "
        "none but"
    )
    print("the line joins two of its points, and it is the shortest curve between them")

    path = options.output / "abnormal_extremals.png"
    fronts = {epsilon: front(epsilon, options.front) for epsilon in (0.0, EPSILON)} if options.front else {}
    paths = dict(zip(angles.tolist(), nodes, strict=True))
    plot(paths, dict(zip(costates.tolist(), leaving, strict=True)), fronts, path)
    print(f"written: {path}")
    return classified, line, errors, (straight, departures), heights


if __name__ == "__main__":
    main()
