r"""
Abnormal extremals
==================

The shortest horizontal curves of the Martinet distribution include an abnormal
extremal, the line :math:`x = 0`, :math:`z = 0`. In a flat metric
(:math:`\epsilon = 0`) the line is a normal extremal too, in other metrics it is
not:

.. math::

    \dot q = u_1 X_1 + u_2 X_2, \qquad X_1 = \partial_x, \quad
    X_2 = \frac{\partial_y + \frac{x^2}{2}\,\partial_z}{1 + \epsilon x}, \qquad
    \text{minimise } \int \tfrac12 (u_1^2 + u_2^2)\,dt

Sources: W. Liu and H. J. Sussmann, *Memoirs of the AMS* 564, 1995; A. Agrachev,
B. Bonnard, M. Chyba and I. Kupka, *ESAIM: COCV* 2, 1997, for the flat metric.
"""

# %%
# The classification
# ------------------
# Abnormal extremals do not depend on the cost. The conditions are
# :math:`p_1 = 0`, :math:`p_2 + p_3 x^2/2 = 0` and :math:`x u_1 = x u_2 = 0`.
# Their solutions have two pieces: curves at rest, :math:`u = 0`, and the
# surface :math:`x = 0`, where the form has rank 2 and :math:`u_2`, the speed
# along the line, is free. The two pieces cross.
import equinox as eqx
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import retrax as rx
from retrax.integrators import (
    SUZUKI,
    Composition,
    PresymplecticIntegrator,
    singular_integrator,
)
from retrax.retractions import Addition, CotangentLift
from scipy.special import ellipe, ellipeinc, ellipj, ellipk

jax.config.update("jax_enable_x64", True)

Q = rx.Euclidean(3)
EPSILON = 0.5


class Martinet(eqx.Module):
    """The velocity at ``q = (x, y, z)``."""

    epsilon: float | jax.Array

    def __call__(self, q, u):
        along = u[1] / (1 + self.epsilon * q[0])
        return jnp.stack([u[0], along, along * q[0] ** 2 / 2])


def martinet(epsilon, abnormal=False):
    """The problem of the shortest horizontal curves."""
    return rx.OptimalControlProblem(
        Q, Martinet(epsilon), lambda q, u: u @ u / 2, 2, abnormal=abnormal
    )


for epsilon in (0.0, EPSILON):
    exact = rx.classify(martinet(epsilon, abnormal=True), symbolic=True)
    pieces = [
        (len(s.coordinates), len(s.kernel), s.k_f, len(s.controls))
        for s in exact.strata
    ]
    # Dimension, kernel of the form, level, determined controls.
    assert pieces == [(4, 0, 1, 2), (3, 1, 2, 1)]
print(exact)

# %%
# The numeric algorithm starts at random points and finds the same pieces. It
# reports the crossing as irregular.
for epsilon in (0.0, EPSILON):
    found = rx.classify(martinet(epsilon, abnormal=True))
    signatures = [s.signature for s in found.strata]
    pieces = [(6 - s.codimension, s.free_controls) for s in signatures]
    assert pieces == [(4, 0), (3, 1)]
    assert found.irregular
print(found)

# %%
# The abnormal line
# -----------------
# The integrator on the second piece, with the speed 1 as the gauge control:
lines = found.choose([s.free_controls for s in found.strata].index(1))
method, choice = singular_integrator(
    lines, rx.Midpoint(Addition(Q)), gauge=lambda t, q, p: jnp.ones(1)
)
start = lines.manifold.nearby((jnp.zeros(3), jnp.array([0.0, 0.0, 1.0])))
line = rx.integrate(found.problem, method, start, 0.1, 10).q
print(choice)
print(f"the line of length 1 ends at {line[-1]}")
exact = np.linspace(0, 1, 11)[:, None] * [0, 1, 0]
np.testing.assert_allclose(line, exact, atol=1e-14)

# %%
# Flat geodesics
# --------------
# In the flat metric the normal extremals are Jacobi's elliptic functions. Their
# angle to the line is a pendulum,
# :math:`\ddot\varphi = -p_3 \sin\varphi`:
MIDPOINT = PresymplecticIntegrator(CotangentLift(rx.Midpoint(Addition(Q))))
METHODS = {2: MIDPOINT, 4: Composition(MIDPOINT, SUZUKI)}


def geodesics(epsilon, angle, p3, horizon, steps, order=2):
    """Nodes of normal extremals from 0, at unit speed."""
    p0 = jnp.broadcast_arrays(jnp.sin(angle), jnp.cos(angle), p3)
    problem = martinet(jnp.asarray(epsilon))

    def path(p0):
        start, step = (jnp.zeros(3), p0), horizon / steps
        return rx.integrate(problem, METHODS[order], start, step, steps).q

    costates = jnp.stack(p0, axis=-1).reshape(-1, 3)
    return np.asarray(jax.jit(jax.vmap(path))(costates))


def flat_geodesic(t, angle, p3):
    """The closed form in the flat metric, for a positive ``p3``."""
    rate, m = np.sqrt(p3), np.sin(angle / 2) ** 2
    quarter = ellipk(m)
    s = rate * t - quarter

    def primitives(s):
        """Of ``sn^2`` and ``sn^4``."""
        sn, cn, dn, amplitude = ellipj(s, m)
        square = (s - ellipeinc(amplitude, m)) / m
        return square, (sn * cn * dn - s + 2 * (1 + m) * square) / (3 * m)

    begin = primitives(-quarter)
    square, fourth = (a - b for a, b in zip(primitives(s), begin, strict=True))
    x = 2 * np.sin(angle / 2) / rate * ellipj(s, m)[1]
    z = 2 * m / rate**3 * (rate * t - (1 + 2 * m) * square + 2 * m * fourth)
    return np.stack([x, t - 2 * m / rate * square, z], axis=-1)


angles, times = np.array([1.2, 0.5, 2.2, 3.0]), np.linspace(0, 5, 400)
exact = flat_geodesic(5.0, angles[0], 4.0)
for order in METHODS:
    runs = [geodesics(0.0, angles, 4.0, 5.0, n, order) for n in (100, 200)]
    errors = [np.max(np.abs(run[0, -1] - exact)) for run in runs]
    measured = np.log2(errors[0] / errors[1])
    print(f"error {errors[1]:.1e} after 200 steps, of order {measured:.2f}")
    assert abs(measured - order) <= 0.05
assert errors[1] <= 2e-7

figure, axis = plt.subplots(figsize=(7, 4), layout="constrained")
for angle, nodes in zip(angles, runs[1], strict=True):
    closed = flat_geodesic(times, angle, 4.0)
    (line,) = axis.plot(closed[:, 1], closed[:, 0], label=f"angle {angle}")
    axis.plot(nodes[::4, 1], nodes[::4, 0], ".", color=line.get_color())
axis.set(xlabel="$y$", ylabel="$x$")
axis.legend()

# %%
# Along the line
# --------------
# In the flat metric the line is a normal extremal for every :math:`p_3`. In the
# other metric normal extremals that start along the line turn back at
# :math:`x = 2\epsilon/p_3`. The line is their limit as :math:`p_3` grows.
costates = np.array([25.0, 100.0, 400.0, 1600.0])
straight = geodesics(0.0, 0.0, costates, 1.0, 400)
leaving = geodesics(EPSILON, 0.0, costates, 1.0, 400)
departures = costates * np.max(np.abs(leaving[..., 0]), axis=1)
print(f"p3 times the largest x: {departures}, exactly {2 * EPSILON}")
assert np.all(straight[..., 0] == 0)
np.testing.assert_allclose(departures, 2 * EPSILON, rtol=1e-3)

figure, axis = plt.subplots(figsize=(7, 4), layout="constrained")
for p3, nodes in zip(costates, leaving, strict=True):
    axis.plot(nodes[:, 1], nodes[:, 0], label=f"$p_3 = {p3:g}$")
axis.axhline(0, color="k", label="abnormal line")
axis.set(xlabel="$y$", ylabel="$x$")
axis.legend()

# %%
# The shortest curve
# ------------------
# The height :math:`z` at which a flat geodesic returns to :math:`x = 0` is
# positive. So only the line joins two of its points, and the line is the
# shortest curve between them. For each quarter of a period, in the unit
# :math:`2 m\,p_3^{-3/2}` with :math:`m = \sin^2(\varphi/2)`, the height is
# an expression in complete elliptic integrals:
m = np.linspace(1e-6, 1 - 1e-12, 10_001)
quarter = ellipk(m)
square = (quarter - ellipe(m)) / m
fourth = (2 * (1 + m) * square - quarter) / 3
heights = quarter - (1 + 2 * m) * square + 2 * fourth
print(f"smallest height {heights.min():.4f}")
assert np.all(heights > 0.333)

# sphinx_gallery_start_ignore
if "__file__" in globals():  # python examples/NAME.py [--output FOLDER]
    import sys
    from pathlib import Path

    default = Path(__file__).parent / "output"
    output = Path(sys.argv[2]) if sys.argv[1:2] == ["--output"] else default
    output.mkdir(parents=True, exist_ok=True)
    for number in plt.get_fignums():
        path = output / f"{Path(__file__).stem}_{number}.png"
        plt.figure(number).savefig(path, dpi=150)
        print(f"written: {path}")
# sphinx_gallery_end_ignore
