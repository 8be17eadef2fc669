r"""Rolling balls

Balls that roll without slipping on a plane: nonholonomic systems, integrated as Dirac systems on
:math:`T^*(SO(3) \times \mathbb R^2)`.

    H = \tfrac12\, \mu \cdot J^{-1}\mu + \tfrac12 \lvert p\rvert^2 - s \cdot x, \qquad
    \dot x = a\,w \times e_3 + \Omega\, e_3 \times x

Mass and radius :math:`a` are 1, the rate :math:`w` is spatial and :math:`s` the slope.

* A homogeneous ball, :math:`J = 2/5`, on a table that turns with :math:`\Omega` rolls on circles, with :math:`2/7` of
  :math:`\Omega` [Earnshaw, 1844].
* On a plane at rest whose gravity along itself is ``slope`` it accelerates by 5/7 of it, on a parabola.
* A ball with three different moments of inertia [Chaplygin, 1903] keeps its angular momentum
  :math:`K = m + a\,e_3 \times p` about the point of contact: three symmetries whose generators satisfy the
  constraints.

Kept to rounding: the constraints, and :math:`K`. Not kept: the energy, with an error of :math:`O(h^2)` that stays
bounded here, where the motion is reversible and integrable, as it need not elsewhere; and the symplectic form, which
the flow does not keep either. On the turning table the energy itself is no constant of motion, but the moving energy
:math:`H - \Omega\,e_3 \cdot (x \times p + m)` is.

    python examples/rolling_ball.py [--steps 10000] [--output examples/output]
"""

import argparse
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import matplotlib as mpl
import numpy as np
from retrax.integrators import DiracIntegrator, DiracSystem, integrate
from retrax.manifolds import SO, Euclidean, hat
from retrax.retractions import Cayley, CotangentLift, Midpoint

jax.config.update("jax_enable_x64", True)
mpl.use("Agg")
import matplotlib.pyplot as plt

ATTITUDES = SO(3)
Q = ATTITUDES * Euclidean(2)
METHOD = DiracIntegrator(CotangentLift(Midpoint(Cayley(Q))))
STEP, EVERY = 0.02, 10
TURN = jnp.array([[0.0, -1.0], [1.0, 0.0]])
SPIN = 2.0


class Ball(eqx.Module):
    """Moments of inertia, angular velocity of the table, and gravity along it."""

    inertia: jax.Array
    spin: float | jax.Array = 0.0
    slope: tuple | jax.Array = (0.0, 0.0)

    def energy(self, q, p):
        """The Hamiltonian."""
        mu = ATTITUDES.body(q[0], p[0])
        return mu @ (mu / self.inertia) / 2 + p[1] @ p[1] / 2 - jnp.asarray(self.slope) @ q[1]

    def forms(self, q):
        """``x' - w x e_3``: the velocity of the point of contact."""
        rates = jax.vmap(hat)(jnp.eye(3)) @ q[0] / 2  # one-forms with values w_1, w_2, w_3
        return jnp.stack([-rates[1], rates[0]]), jnp.eye(2)

    def rates(self, q):
        """The velocity of the table there."""
        return self.spin * (TURN @ q[1])

    def start(self, w, x):
        """The state that rolls at ``x`` with spatial angular velocity ``w``, axes of inertia along those of space."""
        velocity = jnp.array([w[1], -w[0]]) + self.spin * (TURN @ x)
        return (jnp.eye(3), jnp.asarray(x)), (ATTITUDES.covector(jnp.eye(3), self.inertia * jnp.asarray(w)), velocity)

    def roll(self, w, x, steps, step=STEP):
        """The trajectory from there."""
        ball = jax.tree.map(lambda leaf: jnp.asarray(leaf, float), self)
        system = DiracSystem(Q, ball.energy, ball.forms, ball.rates)
        return integrate(system, METHOD, ball.start(w, jnp.asarray(x)), step, steps, save_every=EVERY)

    def slip(self, path):
        """Largest violation of the constraints at the nodes."""
        system = DiracSystem(Q, self.energy, self.forms, self.rates)
        return float(
            jnp.max(jnp.abs(jax.vmap(lambda q, p: system.constraint(q, system.velocity(q, p)))(path.q, path.p)))
        )


def momenta(path):
    """Spatial angular momentum ``m`` of a ball, and ``K``."""
    m = jax.vmap(ATTITUDES.spatial)(path.q[0], path.p[0])
    p = jnp.pad(path.p[1], ((0, 0), (0, 1)))
    return np.asarray(m), np.asarray(m + jnp.cross(jnp.array([0.0, 0.0, 1.0]), p))


def frequency(path):
    """Mean frequency at which the velocity turns, over that of the table."""
    angle = np.unwrap(np.arctan2(path.p[1][:, 1], path.p[1][:, 0]))
    return (angle[-1] - angle[0]) / float(path.times[-1]) / SPIN


def turntable(steps):
    """A homogeneous ball on the table: paths, frequencies, errors of the centre, force and moving energy, slip."""
    ball, turn = Ball(jnp.full(3, 0.4), SPIN), np.asarray(TURN)
    paths = [ball.roll(w, x, steps) for w, x in (([0.3, -0.2, 0.5], [0.4, 0.1]), ([1.0, 0.8, 0.0], [-0.3, 0.2]))]
    x, p = (np.asarray(part) for part in (paths[0].q[1], paths[0].p[1]))
    finer = ball.roll([0.3, -0.2, 0.5], [0.4, 0.1], steps, STEP / 2)
    centres = x + p @ turn.T / (2 / 7 * SPIN)
    m, _ = momenta(paths[0])
    moving = np.asarray(jax.vmap(ball.energy)(paths[0].q, paths[0].p)) - SPIN * (
        x[:, 0] * p[:, 1] - x[:, 1] * p[:, 0] + m[:, 2]
    )
    force = np.linalg.norm(paths[0].controls, axis=1) / np.linalg.norm(p[0]) / (2 / 7 * SPIN) - 1
    worst = [float(np.max(np.abs(error))) for error in (centres - centres[0], force, moving - moving[0])]
    return paths, (frequency(paths[0]), frequency(finer)), worst, max(ball.slip(path) for path in paths)


def slide(steps):
    """Acceleration on an inclined plane over gravity along it, and the largest distance from the parabola."""
    ball, slope = Ball(jnp.full(3, 0.4), slope=(0.6, 0.3)), np.array([0.6, 0.3])
    path = ball.roll([0.5, 0.2, 1.0], [0.0, 0.0], min(steps, 1000))
    t, x, v = np.asarray(path.times)[:, None], np.asarray(path.q[1]), np.asarray(path.p[1])
    acceleration = (v[-1] - v[0]) @ slope / (t[-1, 0] * slope @ slope)
    return acceleration, float(np.max(np.abs(x - v[0] * t - 5 / 14 * slope * t**2)) / np.max(np.abs(x)))


def chaplygin(steps):
    """A ball of three moments of inertia: its path, the errors of energy and ``K``, and its slip."""
    ball = Ball(jnp.array([0.2, 0.4, 0.55]))
    path = ball.roll([0.1, 1.0, 0.8], [0.0, 0.0], steps)
    energies, (_, k) = np.asarray(jax.vmap(ball.energy)(path.q, path.p)), momenta(path)
    return path, energies - energies[0], np.max(np.abs(k - k[0]), axis=1), ball.slip(path)


def plot(circles, path, energy, momentum, target):
    """Paths of the points of contact, and the errors of what is and what is not kept."""
    figure, axes = plt.subplots(1, 3, figsize=(15, 4.8), layout="constrained")
    for circle in circles:
        x = np.asarray(circle.q[1])
        axes[0].plot(*x.T, linewidth=0.8)
        axes[0].plot(*x[0], "ko", markersize=4)
    axes[0].plot(0, 0, "k+", label="axis of the table")
    axes[0].legend()
    axes[0].set(title=rf"homogeneous ball on a turning table, $\Omega = {SPIN:g}$", aspect="equal")
    axes[1].plot(*np.asarray(path.q[1][:201]).T, linewidth=1)
    axes[1].set(title="ball of three moments of inertia on a table at rest")
    for axis in axes[:2]:
        axis.set(xlabel="$x_1$", ylabel="$x_2$")
    for name, error in (("energy", np.abs(energy)), ("momentum about the contact", momentum)):
        axes[2].semilogy(path.times[1:], np.maximum(error[1:], 1e-17), linewidth=0.8, label=name)
    axes[2].set(title=f"the same ball: errors at steps of {STEP}", xlabel="time")
    axes[2].legend()
    figure.savefig(target, dpi=150)
    plt.close(figure)


def main(arguments=None):
    """Roll, compare with what is known, plot; returns the numbers that are printed."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--steps", type=int, default=10_000, help="number of steps, a multiple of 10")
    parser.add_argument("--output", type=Path, default=Path(__file__).parent / "output", help="folder of the figures")
    options = parser.parse_args(arguments)
    options.output.mkdir(parents=True, exist_ok=True)

    circles, (coarse, fine), (centre, force, moving), slip = turntable(options.steps)
    limit = (4 * fine - coarse) / 3
    print(f"turning table: frequency {coarse:.6f} Omega, {fine:.6f} with half the step, extrapolated {limit:.8f};")
    print(f"  2/7 = {2 / 7:.8f}; largest slip {slip:.1e}; the centre of the circle wanders by {centre:.1e},")
    print(f"  the force errs by {force:.1e} of itself, the moving energy by {moving:.1e}")
    acceleration, parabola = slide(options.steps)
    print(
        f"inclined plane: acceleration {acceleration:.12f}, 5/7 = {5 / 7:.12f}; off the parabola by {parabola:.1e} of "
        "its size"
    )
    path, energy, momentum, rolled = chaplygin(options.steps)
    quarters = [float(np.max(np.abs(part))) for part in np.array_split(energy, 4)]
    print(
        f"three moments of inertia: largest slip {rolled:.1e}, momentum about the contact changes by "
        f"{momentum.max():.1e},"
    )
    print("  energy error in each quarter: " + "  ".join(f"{worst:.2e}" for worst in quarters))

    target = options.output / "rolling_ball.png"
    plot(circles, path, energy, momentum, target)
    print(f"written: {target}")
    return (
        (coarse, fine, centre, force, moving),
        (acceleration, parabola),
        (quarters, float(momentum.max())),
        max(slip, rolled),
    )


if __name__ == "__main__":
    main()
