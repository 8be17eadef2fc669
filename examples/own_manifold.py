r"""
Three custom manifolds
======================

You can add a manifold of your own: a torus from one function, an ellipsoid with
a retraction in closed form, and the Heisenberg group from its Lie algebra. The
conformance kit checks each manifold. An optimal control problem on each has a
known optimum:

.. math::

    \text{minimise } \tfrac12 \int_0^1 \lvert u\rvert^2\,dt

The guide :doc:`/own_manifold` explains the classes.
"""

# %%
# A torus
# -------
# The points at distance 1 from a circle of radius 2. A ``LevelSet`` needs the
# equation, and the projection is a retraction of any level set.
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import retrax as rx
from retrax.manifolds import MatrixLieGroup
from retrax.retractions import Projection, Retraction
from retrax.testing import check_lie_group, check_manifold, check_retraction
from scipy.special import ellipeinc

jax.config.update("jax_enable_x64", True)


class Torus(rx.LevelSet):
    """Points at distance 1 from a circle of radius 2."""

    def constraint(self, x):
        return (jnp.sqrt(x[0] ** 2 + x[1] ** 2) - 2.0) ** 2 + x[2] ** 2 - 1.0


def summary(report):
    """The first line of a report; each other line is a ``Check``."""
    print(str(report).splitlines()[0])
    assert not report.failures


torus = Torus(shape=(3,))
summary(check_manifold(torus))
summary(check_retraction(Projection(torus)))


def geodesic(retraction, start, end):
    """A curve of least energy between two points of a surface."""
    m = retraction.manifold
    problem = rx.OptimalControlProblem(
        m, lambda q, u: m.projection(q, u), lambda q, u: u @ u / 2, controls=3
    )
    method = rx.Midpoint(retraction)
    return rx.solve(problem, start, end, 1.0, method=method, steps=50)


def compare(solution, known):
    """The relative difference of the cost and the known optimum."""
    difference = solution.cost / known - 1
    print(f"cost {solution.cost:.6f}, known {known:.6f}: {difference:.1e}")
    return difference


def on_surface(solution, x, y, z):
    """The path of a solution on the wires of its surface."""
    axis = plt.figure(figsize=(6, 4)).add_subplot(
        projection="3d", computed_zorder=False, elev=45
    )
    axis.plot_wireframe(x, y, z, color="0.8", linewidth=0.4, zorder=0)
    rx.plotting.path(solution, ax=axis)
    axis.set_box_aspect([np.ptp(x), np.ptp(y), np.ptp(z)], zoom=1.3)
    axis.set_axis_off()


# %%
# Along the outer equator, by an angle of 1 on a circle of radius 3, the cost is
# :math:`9/2`. The midpoint rule has order 2:
start = np.array([3.0, 0.0, 0.0])
end = 3.0 * np.array([np.cos(1.0), np.sin(1.0), 0.0])
around = geodesic(Projection(torus), start, end)
assert 0 < compare(around, 4.5) < 2e-4
phi, theta = np.mgrid[0 : 2 * np.pi : 25j, 0 : 2 * np.pi : 49j]
far = 2 + np.cos(phi)
on_surface(around, far * np.cos(theta), far * np.sin(theta), np.sin(phi))

# %%
# An ellipsoid
# ------------
# On :math:`x^\top A x = 1` a retraction scales the sum of point and tangent:
#
# .. math::
#
#    R(x, v) = \frac{x + v}{\sqrt{(x + v)^\top A\,(x + v)}}, \qquad
#    R_x^{-1}(y) = \frac{y}{x^\top A y} - x


class Ellipsoid(rx.LevelSet):
    """Points with ``sum(weights * x**2) == 1``."""

    weights: jax.Array

    def constraint(self, x):
        return x @ (self.weights * x) - 1.0


class RadialRetraction(Retraction):
    """The retraction along rays from the centre."""

    manifold: Ellipsoid

    def retract(self, x, v):
        moved = x + v
        return moved / jnp.sqrt(moved @ (self.manifold.weights * moved))

    def preimage(self, x, y):
        height = x @ (self.manifold.weights * y)
        return jnp.where(height > 0, y / height - x, jnp.nan)

    def domain(self, x, v):
        return jnp.all(jnp.isfinite(v))


weights = jnp.array([1.0, 2.0, 3.0])
ellipsoid = Ellipsoid(shape=(3,), weights=weights)
summary(check_manifold(ellipsoid))
summary(check_retraction(RadialRetraction(ellipsoid)))

# %%
# Along a quarter of the ellipse with half axes 1 and :math:`1/\sqrt2` the cost
# is half the square of its length, an elliptic integral:
length = ellipeinc(np.pi / 2, 1 - 2.0) / np.sqrt(2.0)
start, end = np.array([1.0, 0.0, 0.0]), np.array([0.0, np.sqrt(0.5), 0.0])
quarter = geodesic(RadialRetraction(ellipsoid), start, end)
assert 0 < compare(quarter, length**2 / 2) < 4e-4
phi, theta = np.mgrid[0 : np.pi : 19j, 0 : 2 * np.pi : 37j]
sphere = np.sin(phi) * np.cos(theta), np.sin(phi) * np.sin(theta), np.cos(phi)
on_surface(quarter, *(x / a**0.5 for x, a in zip(sphere, weights, strict=True)))

# %%
# The Heisenberg group
# --------------------
# Upper triangular matrices with unit diagonal. Their Lie algebra has three
# generators, and the exponential is a retraction:


class Heisenberg(MatrixLieGroup):
    """Upper triangular matrices with unit diagonal."""

    @property
    def algebra(self):
        a = np.zeros((3, 3, 3))
        a[0, 0, 1] = a[1, 1, 2] = a[2, 0, 2] = 1.0
        return a


group = Heisenberg()
summary(check_lie_group(group))

# %%
# Two controls move three coordinates :math:`(a, b, c)`:
# :math:`\dot a = u_1`, :math:`\dot b = u_2`, :math:`\dot c = a\,u_2`. A closed
# loop in the plane of :math:`a` and :math:`b` encloses the area :math:`c`. The
# circle is the shortest loop, so the cost for the area :math:`1/2` is
# :math:`\pi`. The guess is a circle:
problem = rx.OptimalControlProblem(
    group,
    lambda x, u: x @ group.hat(jnp.append(u, 0.0)),
    lambda x, u: u @ u / 2,
    controls=2,
)
end = np.eye(3)
end[0, 2] = 0.5
t = (np.arange(50) + 0.5) / 50
turn = 2 * np.pi * t
states = np.tile(np.eye(3), (50, 1, 1))
states[:, 0, 1], states[:, 1, 2] = np.sin(turn), 1 - np.cos(turn)
states[:, :2, 1:] /= 2 * np.pi
states[:, 0, 2], states[:, 1, 1] = t / 2, 1.0
guess = rx.Guess(states, np.stack([np.cos(turn), np.sin(turn)], axis=1))
method = rx.Midpoint(rx.Exponential(group))
loop = rx.solve(
    problem, np.eye(3), end, 1.0, method=method, steps=50, guess=guess
)
assert 0 < compare(loop, np.pi) < 2e-3
axis = plt.figure(figsize=(5, 4)).add_subplot(aspect="equal")
axis.plot(loop.states[:, 0, 1], loop.states[:, 1, 2])
axis.set(xlabel="a", ylabel="b")

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
