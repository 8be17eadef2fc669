r"""
Open-loop dispersion of slews
=============================

The optimal torques for a nominal spacecraft drive 500 spacecraft that differ
from it. The moments of inertia differ by 2 % and the first rates by 0.5 mrad/s
(standard deviations). geomstats computes the mean and the principal directions
of the last attitudes, which are points of :math:`SO(3)`:

.. math::

    \dot R = R\,\hat w, \qquad J\dot w + w \times Jw = u, \qquad
    \text{minimise } \tfrac12 \int \lvert u\rvert^2\,dt
"""

# %%
# The nominal slew
# ----------------
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import retrax as rx
from retrax.interop import to_geomstats
from retrax.manifolds import vee

jax.config.update("jax_enable_x64", True)

J = jnp.array([5621.0, 4547.0, 2364.0])  # kg m^2, principal axes
STEPS, STEP = 60, 1.0  # s
Q = rx.SO(3) * rx.Euclidean(3)  # attitude R, body rate w in rad/s
EXP = rx.Exponential(rx.SO(3))


def spin(w, u, J):
    """Rate of change of the body rate under a torque."""
    return (u - jnp.cross(w, J * w)) / J


problem = rx.OptimalControlProblem(
    Q,
    lambda q, u: (q[0] @ rx.hat(q[1]), spin(q[1], u, J)),
    running_cost=lambda q, u: u @ u / 2,
    controls=3,
)
turn = np.deg2rad(jnp.array([50.0, 100.0, -100.0]))
target = EXP(jnp.eye(3), rx.hat(turn))
start, end = (np.eye(3), np.zeros(3)), (target, np.zeros(3))
method = rx.Midpoint(rx.Cayley(Q))
solution = rx.solve(problem, start, end, 60.0, method=method, steps=STEPS)
torques = jnp.asarray(solution.controls)

# %%
# The samples
# -----------
# Each step of the simulation has two Runge-Kutta steps of the rate, and turns
# the attitude with the rate between them.


def last_attitude(torques, error):
    """Last attitude with errors of the relative inertia and first rate."""
    inertia = J * (1 + error[:3])

    def half(w, u):
        k1 = spin(w, u, inertia)
        k2 = spin(w + STEP / 4 * k1, u, inertia)
        k3 = spin(w + STEP / 4 * k2, u, inertia)
        k4 = spin(w + STEP / 2 * k3, u, inertia)
        return w + STEP / 12 * (k1 + 2 * k2 + 2 * k3 + k4)

    def step(state, u):
        R, w = state
        middle = half(w, u)
        return (EXP(R, STEP * R @ rx.hat(middle)), half(middle, u)), None

    return jax.lax.scan(step, (jnp.eye(3), error[3:]), torques)[0][0]


SPREAD = jnp.array([0.02, 0.02, 0.02, 5e-4, 5e-4, 5e-4])  # -, rad/s
errors = SPREAD * jax.random.normal(jax.random.key(0), (500, 6))
sample = jax.jit(jax.vmap(last_attitude, (None, 0)))
attitudes = np.asarray(sample(torques, errors))

# %%
# The mean and the principal directions
# -------------------------------------
# The mean of the logarithms at the Fréchet mean is zero.
space = to_geomstats(rx.SO(3))
from geomstats.learning.frechet_mean import FrechetMean
from geomstats.learning.pca import TangentPCA


def rotation_vectors(centre, attitudes):
    """Rotation vectors from a centre to attitudes, in the body frame, rad."""
    return jax.vmap(lambda y: vee(centre.T @ EXP.preimage(centre, y)))(
        attitudes
    )


mean = FrechetMean(space).set(epsilon=1e-24).fit(attitudes).estimate_
pca = TangentPCA(space, n_components=3).fit(attitudes, base_point=mean)
parts = pca.components_.reshape(3, 3, 3)
# A rotation vector w is the matrix hat(w), whose norm is sqrt(2) |w|.
deviations = np.sqrt(pca.explained_variance_ / 2)
axes = np.stack([vee(jnp.asarray(mean.T @ a)) * np.sqrt(2) for a in parts])
cloud = np.asarray(rotation_vectors(mean, attitudes))
away = np.linalg.norm(rotation_vectors(target, mean[None])[0])
print(f"the mean is {np.rad2deg(away):.3f} degrees from the target")
print(f"mean logarithm {np.max(np.abs(cloud.mean(axis=0))):.1e} rad")

figure, panels = plt.subplots(1, 2, figsize=(10, 5), layout="constrained")
around = np.linspace(0, 2 * np.pi, 100)
circle = 2 * np.stack([np.cos(around), np.sin(around)])
along = np.rad2deg(cloud @ axes.T)
names = {1: "second", 2: "third"}
for panel, (k, name) in zip(panels, names.items(), strict=True):
    panel.scatter(along[:, 0], along[:, k], s=6, alpha=0.5)
    panel.plot(*(np.rad2deg(deviations[[0, k]])[:, None] * circle), color="C3")
    panel.set_xlabel("along the first principal axis [deg]")
    panel.set_ylabel(f"along the {name} principal axis [deg]")
    panel.set_aspect("equal", "datalim")
figure.suptitle("Last attitudes, with ellipses of two standard deviations")

# %%
# The linear prediction
# ---------------------
# The derivative of the last attitude with respect to the errors predicts the
# principal standard deviations.
nominal = last_attitude(torques, jnp.zeros(6))
slope = jax.jacfwd(
    lambda error: rotation_vectors(
        nominal, last_attitude(torques, error)[None]
    )[0]
)(jnp.zeros(6))
variances = np.linalg.eigvalsh((slope * SPREAD**2) @ slope.T)[::-1]
linear = np.sqrt(variances)
print("principal standard deviations [deg]", np.rad2deg(deviations).round(4))
print("linear prediction             [deg]", np.rad2deg(linear).round(4))
assert np.max(np.abs(cloud.mean(axis=0))) <= 1e-10
np.testing.assert_allclose(deviations, linear, rtol=0.1)

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
