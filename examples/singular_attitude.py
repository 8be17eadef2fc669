r"""
Singular attitude control
=========================

Two spacecraft have torques without a cost. The Hamiltonian does not determine
these torques, and the extremals lie on a manifold :math:`P_f` of dimension 10
or 8 in the 12-dimensional :math:`T^*Q`. RATTLE preserves the manifold, its
symplectic form and the spatial angular costate to rounding:

.. math::

    \dot R = R\,\hat w, \quad J\dot w + w \times Jw = u, \qquad
    \text{minimise } \int \tfrac12 (u_1^2 + u_2^2) + \lvert w\rvert^2\,dt
    \quad\text{or}\quad \int \lvert w\rvert^2\,dt

The third torque has no cost in the first problem. In the second problem the
third actuator has failed, and the other torques have no cost.
"""

# %%
# The problems
# ------------
# The problem library has the first problem.
import equinox as eqx
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import retrax as rx
from retrax.integrators import singular_integrator, symplecticity_defect
from retrax.manifolds.numerics import ambient

jax.config.update("jax_enable_x64", True)

J = jnp.array([1.0, 1.7, 2.3])
Q = rx.SO(3) * rx.Euclidean(3)  # attitude R, body rate w


def dynamics(q, u):
    """Velocities without a torque about the third axis."""
    R, w = q
    u = jnp.append(u, 0.0)
    return R @ rx.hat(w), (u - jnp.cross(w, J * w)) / J


free = rx.problems.SINGULAR["free actuator"]().problem
failed = rx.OptimalControlProblem(
    Q, dynamics, lambda q, u: q[1] @ q[1], controls=2
)

# %%
# The analysis
# ------------
# The function below classifies a problem, integrates an extremal with 400 and
# 800 steps, prints the errors and draws the extremal.


@eqx.filter_jit
def along(problem, found, path):
    """Hamiltonian, equations of the manifold, spatial angular costate."""

    def at(q, p):
        energy = problem.hamiltonian(q, p, found.control(q, p))
        equations = ambient.size(found.equations((q, p)))
        return energy, equations, rx.SO(3).spatial(q[0], p[0])

    return jax.vmap(at)(path.q, path.p)


def examine(problem, w, costate, rate_costate, horizon):
    """The classification of a problem, after its errors are printed."""
    found = rx.classify(problem)
    method, choice = singular_integrator(
        found, rx.Midpoint(rx.Cayley(Q)), "rattle"
    )
    print(f"{found}\n{choice}")
    momentum = rx.SO(3).covector(jnp.eye(3), jnp.array(costate))
    start = found.manifold.nearby(
        ((jnp.eye(3), jnp.array(w)), (momentum, jnp.array(rate_costate)))
    )
    sizes = np.array([0.2, 0.1, 0.05])
    form = symplecticity_defect(
        found.presymplectic, method, problem, start, sizes
    )
    print(f"change of the form over one step: {np.max(form):.1e}")
    errors = []
    for n in (400, 800):
        path = rx.integrate(
            problem, method, start, horizon / n, n, save_every=n // 200
        )
        energy, gaps, spatial = map(np.asarray, along(problem, found, path))
        errors.append(np.max(np.abs(energy - energy[0])))
        kept = np.max(np.abs(spatial - spatial[0]))
        print(f"{n} steps: energy error {errors[-1]:.1e}, costate {kept:.1e}")
        assert np.max(gaps) <= 1e-14
        assert kept <= 1e-12
    assert np.max(form) <= 1e-13
    assert abs(np.log2(errors[0] / errors[1]) - 2) <= 0.05

    axes = plt.subplots(1, 3, figsize=(12, 3.5), layout="constrained")[1]
    rx.plotting.state(path, 1, problem=Q, ax=axes[0])
    axes[0].set_ylabel("body rate")
    rx.plotting.controls(path, ax=axes[1])
    axes[1].set_ylabel("torque")
    axes[2].plot(path.times, energy - energy[0])
    axes[2].set(xlabel="time", ylabel="energy error")
    return found.dimension, found.rank, found.k_f, found.second_class


# %%
# The free actuator
# -----------------
# Extremals are saddles, as in a linear quadratic regulator: they come near rest
# about two axes and leave again.
facts = examine(
    free, [1.0, -0.5, 1.5], [0.6, -0.4, 3.0], [-1.1015, 0.2385, 0.0], 8.0
)
assert facts == (10, 10, 2, 2)

# %%
# The failed actuator
# -------------------
# Rotations near the middle axis stay near it, and the energy error oscillates.
facts = examine(failed, [0.5, 1.0, 0.3], [1.0, 2.0, 0.1], [0.0, 0.0, 0.5], 40.0)
assert facts == (8, 8, 2, 4)

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
