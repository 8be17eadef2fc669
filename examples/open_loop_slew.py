r"""Open-loop dispersion of slews

Where a slew ends when the spacecraft is not the one it was computed for: mean and principal directions of 500
attitudes.

    \dot R = R\,\hat w, \qquad J\dot w + w \times Jw = u, \qquad \text{minimise } \tfrac12 \int \lvert u\rvert^2\,dt

The optimal torques for the nominal inertia are played back, open loop, on spacecraft whose inertia is off by 2 % on
each axis and whose first rate is off by 0.5 mrad/s (standard deviations). Their last attitudes are points of SO(3):
geomstats' Fréchet mean and tangent principal component analysis summarise them, on our manifold. Checked are that the
logarithms at the mean average to zero, which is what makes it the Fréchet mean, and that the principal standard
deviations are those of the linearised propagation of the same errors.

    python examples/open_loop_slew.py [--samples 500] [--output examples/output]
"""

import argparse
from pathlib import Path

import jax
import jax.numpy as jnp
import matplotlib as mpl
import numpy as np
from retrax.integrators import OptimalControlProblem, solve
from retrax.interop import to_geomstats
from retrax.manifolds import SO, Euclidean, hat, vee
from retrax.retractions import Cayley, Exponential, Midpoint

jax.config.update("jax_enable_x64", True)
mpl.use("Agg")
import matplotlib.pyplot as plt

INERTIA = jnp.array([5621.0, 4547.0, 2364.0])  # kg m^2, principal axes
HORIZON, STEPS = 60.0, 60
STEP = HORIZON / STEPS
SPREAD = jnp.array([0.02, 0.02, 0.02, 5e-4, 5e-4, 5e-4])  # of the relative inertia, and of the first rate, rad/s
EXP = Exponential(SO(3))
TARGET = EXP(jnp.eye(3), hat(np.deg2rad(150) * jnp.array([1.0, 2.0, -2.0]) / 3))
Q = SO(3) * Euclidean(3)  # attitude R (body to inertial frame), body rate w in rad/s


def spin(rate, torque, inertia):
    """Rate of change of the body rate under a torque in the body frame, N m."""
    return (torque - jnp.cross(rate, inertia * rate)) / inertia


PROBLEM = OptimalControlProblem(
    Q, lambda q, u: (q[0] @ hat(q[1]), spin(q[1], u, INERTIA)), running_cost=lambda q, u: u @ u / 2, controls=3
)


def last_attitude(torques, error):
    """Last attitude with an error ``(relative inertia, first rate)``: rates by Runge-Kutta, attitudes by the
    exponential."""
    inertia = INERTIA * (1 + error[:3])

    def half(rate, torque):
        k1 = spin(rate, torque, inertia)
        k2 = spin(rate + STEP / 4 * k1, torque, inertia)
        k3 = spin(rate + STEP / 4 * k2, torque, inertia)
        k4 = spin(rate + STEP / 2 * k3, torque, inertia)
        return rate + STEP / 12 * (k1 + 2 * k2 + 2 * k3 + k4)

    def step(state, torque):
        attitude, rate = state
        middle = half(rate, torque)
        return (EXP(attitude, STEP * attitude @ hat(middle)), half(middle, torque)), None

    return jax.lax.scan(step, (jnp.eye(3), error[3:]), torques)[0][0]


def rotation_vectors(centre, attitudes):
    """Rotation vectors, in the body frame, that lead from ``centre`` to the attitudes, rad."""
    return jax.vmap(lambda y: vee(centre.T @ EXP.preimage(centre, y)))(attitudes)


def summary(attitudes):
    """Fréchet mean, principal standard deviations, descending, and principal axes, by geomstats."""
    space = to_geomstats(SO(3))
    from geomstats.learning.frechet_mean import FrechetMean  # after the door is open: its import is quiet
    from geomstats.learning.pca import TangentPCA

    mean = FrechetMean(space).set(epsilon=1e-24).fit(attitudes).estimate_
    pca = TangentPCA(space, n_components=3).fit(attitudes, base_point=mean)
    # |x hat(w)|^2 = 2 |w|^2, and the components have unit length in the ambient space.
    axes = [vee(jnp.asarray(mean.T @ component)) * np.sqrt(2) for component in pca.components_.reshape(3, 3, 3)]
    return mean, np.sqrt(pca.explained_variance_ / 2), np.stack(axes)


def plot(errors, deviations, axes, path):
    """The cloud of rotation vectors from the mean, in the planes of the principal axes, with ellipses of two
    deviations."""
    figure, panels = plt.subplots(1, 2, figsize=(10, 5), layout="constrained")
    turn = np.linspace(0, 2 * np.pi, 100)
    along = np.rad2deg(errors @ axes.T)
    for panel, second in zip(panels, (1, 2), strict=True):
        panel.scatter(along[:, 0], along[:, second], s=6, alpha=0.5)
        panel.plot(
            *(2 * np.rad2deg(deviations[[0, second]])[:, None] * np.stack([np.cos(turn), np.sin(turn)])), color="C3"
        )
        panel.set_xlabel("along the first principal axis [deg]")
        panel.set_ylabel(f"along the {('second', 'third')[second - 1]} [deg]")
        panel.set_aspect("equal", "datalim")
    figure.suptitle("Last attitudes around their Fréchet mean, two standard deviations")
    figure.savefig(path, dpi=150)
    plt.close(figure)


def main(arguments=None):
    """Solve, sample, summarise, compare, plot; returns the deviations, those of the linear theory, and the mean
    logarithm."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--samples", type=int, default=500)
    parser.add_argument("--output", type=Path, default=Path(__file__).parent / "output", help="folder of the figures")
    options = parser.parse_args(arguments)
    options.output.mkdir(parents=True, exist_ok=True)

    rest = jnp.zeros(3)
    solution = solve(PROBLEM, (jnp.eye(3), rest), (TARGET, rest), HORIZON, method=Midpoint(Cayley(Q)), steps=STEPS)
    torques = jnp.asarray(solution.controls)
    errors = SPREAD * jax.random.normal(jax.random.key(0), (options.samples, 6))
    attitudes = np.asarray(jax.jit(jax.vmap(last_attitude, (None, 0)))(torques, errors))

    mean, deviations, axes = summary(attitudes)
    cloud = np.asarray(rotation_vectors(mean, attitudes))
    mean_log = np.max(np.abs(cloud.mean(axis=0)))
    nominal = last_attitude(torques, jnp.zeros(6))
    slope = jax.jacfwd(lambda error: rotation_vectors(nominal, last_attitude(torques, error)[None])[0])(jnp.zeros(6))
    linear = np.sqrt(np.linalg.eigvalsh((slope * SPREAD**2) @ slope.T)[::-1])
    away = np.rad2deg(np.linalg.norm(rotation_vectors(TARGET, mean[None])[0]))
    print(
        f"Fréchet mean of {options.samples} attitudes: {away:.3f} degrees from the target, mean logarithm "
        f"{mean_log:.1e} rad"
    )
    print("principal standard deviations [deg]:", np.round(np.rad2deg(deviations), 4))
    print("by linearised propagation     [deg]:", np.round(np.rad2deg(linear), 4))

    plot(cloud, deviations, axes, options.output / "open_loop_slew.png")
    print(f"written: {options.output / 'open_loop_slew.png'}")
    return deviations, linear, mean_log


if __name__ == "__main__":
    main()
