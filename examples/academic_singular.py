r"""
A singular academic problem
===========================

The second control of this problem has no quadratic cost. ``rx.classify`` finds
the manifold of the extremals, and the integrator preserves this manifold:

.. math::

    \dot x = f(x) + u_1, \quad \dot y = y, \qquad
    \text{minimise } \int \tfrac12 (x^2 + y^2 + u_1^2) + x u_1 + y u_2\,dt

The extremals lie on :math:`P_f = \{y = 0\}`. Its presymplectic form has rank 2
and the kernel :math:`\partial/\partial p_y`. The control
:math:`u_1 = p_x - x` is determined, and :math:`u_2` is a gauge control, which
you choose. The problem is in section 5.1 of M. Barbero-Liñán and D. Martín de
Diego, *Presymplectic integrators for optimal control problems via retraction
maps*.
"""

# %%
# The classification
# ------------------
# The classification is the same for every function :math:`f`.
import equinox as eqx
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import retrax as rx
from retrax.integrators import singular_integrator
from retrax.retractions import Addition

jax.config.update("jax_enable_x64", True)

PLANE = rx.Euclidean(2)
START = jnp.array([0.7, 0.0]), jnp.array([-0.3, 0.2])


class Dynamics(eqx.Module):
    """The velocity with ``f = a x + b sin x``."""

    a: jax.Array
    b: jax.Array

    def __call__(self, q, u):
        f = self.a * q[0] + self.b * jnp.sin(q[0])
        return jnp.stack([f + u[0], q[1]])


def classified(a, b):
    """The classification with one function."""
    problem = rx.OptimalControlProblem(
        PLANE,
        Dynamics(jnp.array(a), jnp.array(b)),
        lambda q, u: q @ q / 2 + q @ u + u[0] ** 2 / 2,
        controls=2,
    )
    return rx.classify(problem)


found = classified(0.0, 1.0)
print(found)
assert (found.dimension, found.rank, found.gauge_controls) == (3, 2, 1)

# %%
# The motion
# ----------
# The gauge control is :math:`u_2 = \cos t`. The known values of :math:`x` and
# :math:`p_x` at the time 1 are those of the closed form for linear functions,
# :math:`p_x = p_0 e^{(1-a)t}`,
# :math:`x = x_0 e^{-(1-a)t} + p_0 \sinh((1-a)t)/(1-a)`, and have seven digits
# for :math:`\sin`. The error has order 2:
FUNCTIONS = {"f = 0": (0.0, 0.0), "f = x/2": (0.5, 0.0), "f = sin": (0.0, 1.0)}
KNOWN = {
    "f = 0": (-0.0950447493, -0.8154845485),
    "f = x/2": (0.1119142785, -0.4946163812),
    "f = sin": (0.3473665, -0.3445070),
}
COUNTS = np.array([20, 40, 80])
paths, errors = {}, {}
for name, (a, b) in FUNCTIONS.items():
    found = classified(a, b)
    method, choice = singular_integrator(
        found, rx.Midpoint(Addition(PLANE)), gauge=lambda t, q, p: jnp.cos(t)
    )
    paths[name] = [
        rx.integrate(found.problem, method, START, 1 / n, int(n))
        for n in COUNTS
    ]
    ends = np.array([[x.q[-1, 0], x.p[-1, 0]] for x in paths[name]])
    errors[name] = np.max(np.abs(ends - KNOWN[name]), axis=1)
    print(f"{name:8} errors with {COUNTS} steps: {errors[name]}")
    ratios = errors[name][:-1] / errors[name][1:]
    np.testing.assert_allclose(ratios, 4, atol=0.15)
    assert errors[name][-1] <= 2e-5
print(choice)

# %%
# State, costates and controls for :math:`f = \sin`:
figure, axis = plt.subplots(figsize=(8, 4.5), layout="constrained")
finest = paths["f = sin"][-1]
axis.plot(finest.times, finest.q[:, 0], label="$x$")
axis.plot(finest.times, finest.p, label=["$p_x$", "$p_y$"])
names = ["$u_1 = p_x - x$", r"$u_2 = \cos t$ (gauge)"]
axis.plot(finest.stage_times, finest.controls, "--", label=names)
axis.set(xlabel="time")
axis.legend()

# %%
# The printed scheme
# ------------------
# The paper prints a scheme for this problem: four equations in
# :math:`(x, p_x, p_y, u_1)` for each step, here solved by Newton's method. It
# agrees with the general integrator to rounding.


def printed_scheme(a, b, steps):
    """Nodes (x, p_x, p_y) of the scheme."""
    h = 1 / steps
    nodes = [np.array([START[0][0], *START[1]])]

    def residual(y, k):
        x, p, s = nodes[-1]
        middle, momentum = (x + y[0]) / 2, (p + y[1]) / 2
        f, slope = a * middle + b * jnp.sin(middle), a + b * jnp.cos(middle)
        return jnp.stack(
            [
                (y[0] - x) / h - f - y[3],
                (y[1] - p) / h + momentum * slope - middle - y[3],
                (y[2] - s) / h + (s + y[2]) / 2 - jnp.cos((k + 0.5) * h),
                momentum - middle - y[3],
            ]
        )

    for k in range(steps):
        y = np.append(nodes[-1], nodes[-1][1] - nodes[-1][0])
        for _ in range(6):
            slope = jax.jacfwd(residual)(y, k)
            y = y - np.linalg.solve(slope, residual(y, k))
        nodes.append(y[:3])
    return np.array(nodes)


for name, (a, b) in FUNCTIONS.items():
    path = paths[name][0]
    ours = np.column_stack([path.q[:, 0], path.p])
    difference = np.max(np.abs(ours - printed_scheme(a, b, COUNTS[0])))
    print(f"{name:8} difference to the printed scheme: {difference:.1e}")
    assert difference <= 1e-14

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
