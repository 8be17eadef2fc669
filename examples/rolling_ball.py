r"""
Rolling balls
=============

Balls roll without slipping on a plane. These nonholonomic systems are
integrated as Dirac systems on :math:`T^*(SO(3) \times \mathbb R^2)`. With unit
mass and radius, the spatial angular velocity :math:`w`, the slope :math:`s`
and the rate :math:`\Omega` of the table:

.. math::

    H = \tfrac12\, \mu \cdot J^{-1}\mu + \tfrac12 \lvert p\rvert^2 - s \cdot x,
    \qquad \dot x = w \times e_3 + \Omega\, e_3 \times x
"""

# %%
# The system
# ----------
# ``forms`` returns the one-forms of the constraints, ``rates`` their values.
import equinox as eqx
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import retrax as rx
from retrax.integrators import DiracIntegrator, DiracSystem
from retrax.retractions import CotangentLift

jax.config.update("jax_enable_x64", True)

SO3 = rx.SO(3)
Q = SO3 * rx.Euclidean(2)
METHOD = DiracIntegrator(CotangentLift(rx.Midpoint(rx.Cayley(Q))))
STEP, SPIN, TURN = 0.02, 2.0, np.array([[0.0, -1.0], [1.0, 0.0]])


class Ball(eqx.Module):
    """Moments of inertia, rate of the table, and gravity along the plane."""

    inertia: jax.Array
    spin: jax.Array
    slope: jax.Array

    def energy(self, q, p):
        mu = SO3.body(q[0], p[0])
        kinetic = mu @ (mu / self.inertia) / 2 + p[1] @ p[1] / 2
        return kinetic - self.slope @ q[1]

    def forms(self, q):
        rates = jax.vmap(rx.hat)(jnp.eye(3)) @ q[0] / 2  # w_1, w_2, w_3
        return jnp.stack([-rates[1], rates[0]]), jnp.eye(2)

    def rates(self, q):
        return self.spin * (TURN @ q[1])


def roll(ball, w, x, steps, step=STEP):
    """The trajectory from a spatial angular velocity and a place."""
    system = DiracSystem(Q, ball.energy, ball.forms, ball.rates)
    w, x = np.array(w), np.array(x)
    velocity = np.array([w[1], -w[0]]) + ball.spin * (TURN @ x)
    momentum = SO3.covector(jnp.eye(3), ball.inertia * w)
    start = (jnp.eye(3), x), (momentum, velocity)
    path = rx.integrate(system, METHOD, start, step, steps, save_every=10)
    slip = jax.vmap(lambda q, p: system.constraint(q, system.velocity(q, p)))(
        path.q, path.p
    )
    assert np.max(np.abs(slip)) <= 1e-14, "the ball slips"
    return path


def ball(inertia, spin=0.0, slope=(0.0, 0.0)):
    """A ball with arrays as numbers."""
    return Ball(*(jnp.asarray(a, float) for a in (inertia, spin, slope)))


# %%
# A turning table
# ---------------
# A homogeneous ball, :math:`J = 2/5`, rolls on circles, at 2/7 of the rate of
# the table [S. Earnshaw, *Dynamics*, 1844].
table = ball(np.full(3, 0.4), SPIN)
path = roll(table, [0.3, -0.2, 0.5], [0.4, 0.1], 1000)
finer = roll(table, [0.3, -0.2, 0.5], [0.4, 0.1], 1000, STEP / 2)
other = roll(table, [1.0, 0.8, 0.0], [-0.3, 0.2], 1000)

figure, axis = plt.subplots(layout="constrained")
for circle in (path, other):
    (line,) = axis.plot(*np.asarray(circle.q[1]).T)
    axis.plot(*circle.q[1][0], "o", color=line.get_color())
axis.plot(0, 0, "k+", label="axis of the table")
axis.set(xlabel="$x_1$", ylabel="$x_2$", aspect="equal")
axis.legend()

# %%
# The frequency has order 2, so two step sizes give its limit. The force of the
# constraints is centripetal. On the table the energy changes, but the moving
# energy :math:`H - \Omega\,e_3 \cdot (x \times p + m)` does not:


def frequency(path):
    """Mean frequency of the velocity, over the rate of the table."""
    angle = np.unwrap(np.arctan2(path.p[1][:, 1], path.p[1][:, 0]))
    return (angle[-1] - angle[0]) / float(path.times[-1]) / SPIN


def spatial(path):
    """Spatial angular momentum of the ball."""
    return np.asarray(jax.vmap(SO3.spatial)(path.q[0], path.p[0]))


x, p = np.asarray(path.q[1]), np.asarray(path.p[1])
coarse, fine = frequency(path), frequency(finer)
limit = (4 * fine - coarse) / 3
print(f"frequency {coarse:.6f}, {fine:.6f}, limit {limit:.8f}, {2 / 7:.8f}")
centres = x + p @ TURN.T / (2 / 7 * SPIN)
force = np.linalg.norm(path.controls, axis=1)
force = force / (np.linalg.norm(p[0]) * 2 / 7 * SPIN) - 1
moment = x[:, 0] * p[:, 1] - x[:, 1] * p[:, 0] + spatial(path)[:, 2]
moving = np.asarray(jax.vmap(table.energy)(path.q, path.p)) - SPIN * moment
assert abs(limit / (2 / 7) - 1) <= 1e-6
assert abs((7 / 2 * coarse - 1) / (4 * (7 / 2 * fine - 1)) - 1) <= 0.02
assert np.max(np.abs(centres - centres[0])) <= 1e-12
assert np.max(np.abs(force)) <= 4e-4
assert np.max(np.abs(moving - moving[0])) <= 4e-4

# %%
# An inclined plane
# -----------------
# The ball accelerates by 5/7 of gravity along the plane, on a parabola.
slope = np.array([0.6, 0.3])
path = roll(ball(np.full(3, 0.4), slope=slope), [0.5, 0.2, 1.0], [0, 0], 1000)
t, v = np.asarray(path.times)[:, None], np.asarray(path.p[1])
acceleration = (v[-1] - v[0]) @ slope / (t[-1, 0] * slope @ slope)
x = np.asarray(path.q[1])
off = np.abs(x - v[0] * t - 5 / 14 * slope * t**2)
print(f"acceleration {acceleration:.12f}, 5/7 = {5 / 7:.12f}")
assert abs(acceleration - 5 / 7) <= 1e-12
assert np.max(off) <= 5e-4 * np.max(np.abs(x))

# %%
# Three moments of inertia
# ------------------------
# Chaplygin's ball preserves its angular momentum :math:`K = m + e_3 \times p`
# about the point of contact, to rounding. The energy error stays bounded.
chaplygin = ball([0.2, 0.4, 0.55])
path = roll(chaplygin, [0.1, 1.0, 0.8], [0.0, 0.0], 10_000)
p = np.pad(path.p[1], ((0, 0), (0, 1)))
k = spatial(path) + np.cross([0.0, 0.0, 1.0], p)
momentum = np.max(np.abs(k - k[0]), axis=1)
energy = np.asarray(jax.vmap(chaplygin.energy)(path.q, path.p))
energy = np.abs(energy - energy[0])
quarters = [np.max(part) for part in np.array_split(energy, 4)]
print("energy error", " ".join(f"{worst:.2e}" for worst in quarters))
print(f"change of the momentum {momentum.max():.1e}")

figure, (left, right) = plt.subplots(
    1, 2, figsize=(10, 4), layout="constrained"
)
left.plot(*np.asarray(path.q[1][:201]).T)
left.set(xlabel="$x_1$", ylabel="$x_2$")
right.semilogy(path.times[1:], energy[1:], label="energy")
right.semilogy(path.times[1:], momentum[1:], label="momentum")
right.set(xlabel="time", ylabel="error")
right.legend()
assert momentum.max() <= 1e-12
assert max(quarters[2:]) <= 1.1 * max(quarters[:2]) <= 2e-5

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
