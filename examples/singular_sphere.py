r"""
Singular arcs on the sphere
===========================

The control of this problem has no cost. Its extremals lie on a curved manifold
:math:`P_f` in :math:`T^*S^2` with a symplectic form. RATTLE preserves both to
rounding. A projection method preserves the manifold only, so its energy
drifts:

.. math::

    \dot q = f(q) + u\,e_3 \times q \quad \text{on } S^2, \qquad
    \text{minimise } \int F(q)\,dt
"""

# %%
# The classification
# ------------------
# The problem library has this problem:
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import retrax as rx
from retrax.integrators import (
    Classification,
    singular_integrator,
    symplecticity_defect,
)
from retrax.retractions import Projection

jax.config.update("jax_enable_x64", True)

problem = rx.problems.SINGULAR["sphere"]().problem
found: Classification = rx.classify(problem)
print(found)

# %%
# Both integrators
# ----------------
# ``nearby`` returns a point of the manifold near a guess. The defect is the
# change of the symplectic form over one step.
final = found.manifold
start = final.nearby(
    (jnp.array([-0.93, 0.09, 0.3557]), jnp.array([0.11, -0.01, 0.295]))
)
SIZES, STEP = np.array([0.2, 0.1, 0.05]), 0.1
STEPS = {"rattle": 20_000, "project": 5_000}


def size(equations):
    """The largest entry of the equations of the manifold."""
    leaves = jax.tree.leaves(equations)
    return jnp.max(jnp.stack([jnp.max(jnp.abs(leaf)) for leaf in leaves]))


defects, errors, gaps = {}, {}, {}
for name, steps in STEPS.items():
    method, choice = singular_integrator(
        found, rx.Midpoint(Projection(problem.manifold)), name
    )
    print(choice)
    defects[name] = symplecticity_defect(
        found.presymplectic, method, problem, start, SIZES
    )
    path = rx.integrate(problem, method, start, STEP, steps, save_every=10)
    # On the manifold the Hamiltonian does not depend on the control.
    energy = np.asarray(
        jax.vmap(lambda q, p: problem.hamiltonian(q, p, found.stratum.u))(
            path.q, path.p
        )
    )
    errors[name] = np.asarray(path.times), energy - energy[0]
    residuals = jax.vmap(lambda q, p: size(final.equations((q, p))))
    gaps[name] = float(jnp.max(residuals(path.q, path.p)))
    print(f"    equations of the manifold: {gaps[name]:.1e}")
assert gaps["rattle"] <= 1e-14

# %%
# The symplectic form
# -------------------
# The form changes by :math:`O(h^3)` in a step of the projection method:
figure, axis = plt.subplots(figsize=(7, 4), layout="constrained")
for name, defect in defects.items():
    print(f"{name}: the form changes by {np.asarray(defect)}")
    axis.loglog(SIZES, np.maximum(defect, 1e-17), "o-", label=name)
axis.loglog(SIZES, 0.02 * SIZES**3, "k:", label="slope 3")
axis.set(xlabel="step", ylabel="change of the symplectic form")
axis.legend()
slope, _ = np.polyfit(np.log(SIZES), np.log(defects["project"]), 1)
assert max(defects["rattle"]) <= 1e-13
assert abs(slope - 3) <= 0.2

# %%
# The energy
# ----------
# The drift is the slope of a line through means of the energy error, here with
# its standard error:
figure, axis = plt.subplots(figsize=(7, 4), layout="constrained")
drifts = {}
for name, (times, error) in errors.items():
    t, e = (
        np.array([np.mean(part) for part in np.array_split(a, 50)])
        for a in (times, error)
    )
    (slope, _), covariance = np.polyfit(t, e, 1, cov=True)
    drifts[name] = abs(slope) / np.sqrt(covariance[0, 0])
    print(f"{name}: drift {slope:.1e}, {drifts[name]:.1f} standard errors")
    axis.semilogx(times[1:], error[1:], ".", markersize=2, label=name)
axis.set(xlabel="time", ylabel="energy error")
axis.legend()
assert drifts["rattle"] <= 2
assert drifts["project"] >= 10

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
