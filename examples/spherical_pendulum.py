r"""
Spherical pendulum
==================

A pendulum of unit mass and length swings for 100 000 steps on the sphere. The
energy error of a symplectic integrator stays bounded. The energy error of a
method of the same order without geometry grows. The Hamiltonian is

.. math::

    H(q, p) = \tfrac12 \lvert p\rvert^2 + q_3 \qquad \text{on } T^*S^2
"""

# %%
# The symplectic integrator
# -------------------------
# The lift of the midpoint map to the cotangent bundle gives a symplectic
# integrator of order 2. The projection retraction commutes with rotations, so
# the integrator conserves the vertical angular momentum to rounding.
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import retrax as rx
from retrax.integrators import SymplecticIntegrator
from retrax.retractions import CotangentLift, Projection

jax.config.update("jax_enable_x64", True)

S2 = rx.Sphere(2)
STEP, STEPS, EVERY = 0.02, 100_000, 50
START = jnp.array([1.0, 0.0, 0.0]), jnp.array([0.0, 0.6, 0.3])


def energy(q, p):
    """The Hamiltonian."""
    return p @ p / 2 + q[2]


method = SymplecticIntegrator(CotangentLift(rx.Midpoint(Projection(S2))))
path = rx.integrate(energy, method, START, STEP, STEPS, save_every=EVERY)
q, p = np.asarray(path.q[1:]), np.asarray(path.p[1:])
momentum = np.cross(q, p)[:, 2] - jnp.cross(*START)[2]
off = np.linalg.norm(q, axis=1) - 1
print(f"error of the vertical momentum {np.max(np.abs(momentum)):.1e}")
print(f"distance from the sphere {np.max(np.abs(off)):.1e}")

# %%
# The method without geometry
# ---------------------------
# The explicit midpoint rule in :math:`\mathbb R^3`, for
# :math:`\dot q = p`, :math:`\dot p = -P_q e_3 - \lvert p\rvert^2 q`, projects
# the state to :math:`T^*S^2` after every step.


def field(q, p):
    """Velocities of the position and of the momentum."""
    return p, -S2.projection(q, jnp.array([0.0, 0.0, 1.0])) - (p @ p) * q


def step(z, _):
    """One step with a projection."""
    q, p = z
    dq, dp = field(q, p)
    dq, dp = field(q + STEP / 2 * dq, p + STEP / 2 * dp)
    q, p = q + STEP * dq, p + STEP * dp
    q = q / jnp.linalg.norm(q)
    return (q, S2.projection(q, p)), (q, p)


@jax.jit
def projected(z):
    """One state in ``EVERY``."""
    _, found = jax.lax.scan(step, z, None, length=STEPS)
    return jax.tree.map(lambda a: a[EVERY - 1 :: EVERY], found)


errors = {
    name: np.asarray(jax.vmap(energy)(*states)) - energy(*START)
    for name, states in {
        "symplectic": (q, p),
        "projected": projected(START),
    }.items()
}

# %%
# The energy errors
# -----------------
# The largest error in each quarter of the time:
figure, axis = plt.subplots(figsize=(8, 4.5), layout="constrained")
quarters = {}
for name, error in errors.items():
    parts = np.array_split(np.abs(error), 4)
    quarters[name] = [np.max(part) for part in parts]
    print(name, " ".join(f"{most:.2e}" for most in quarters[name]))
    axis.loglog(path.times[1:], np.abs(error), ".", markersize=2, label=name)
axis.set(xlabel="time", ylabel="size of the energy error")
axis.legend()
assert np.max(np.abs(momentum)) <= 1e-12
assert quarters["symplectic"][3] <= 1.05 * quarters["symplectic"][0]
assert quarters["projected"][3] >= 3 * quarters["projected"][0]

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
