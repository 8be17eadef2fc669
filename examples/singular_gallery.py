r"""
Gallery of singular problems
============================

The integrability algorithm classifies nine singular problems of the literature.
It finds the manifold :math:`P_f` of the extremals, its presymplectic form, and
the controls that stay free (gauge). Four problems have a motion on
:math:`P_f` in closed form.
"""

# %%
# The classification
# ------------------
# The table compares each outcome with the known outcome: the dimension of
# :math:`P_f`, the rank of its form, the number of levels, and the number of
# gauge controls. For two problems there are no extremals.
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import retrax as rx
from retrax.integrators import singular_integrator
from retrax.retractions import default_retraction

jax.config.update("jax_enable_x64", True)

NAMES = (
    *("aly-chan", "massless particle", "brown", "gauge"),
    *("chain of 2", "chain of 3", "chain of 4"),
    *("linear cost", "unpaid control"),
)
found = {}
print(f"{'problem':18} {'dim':>4} {'rank':>4} {'levels':>7} {'gauge':>5}")
for name in NAMES:
    known = rx.problems.SINGULAR[name]()
    c = found[name] = rx.classify(known.problem)
    if known.empty_at is not None:
        print(f"{name:18} no extremals, found at level {len(c.levels) - 1}")
        assert c.empty
        assert len(c.levels) - 1 == known.empty_at
        continue
    print(
        f"{name:18} {c.dimension:4} {c.rank:4} {c.k_f:7} {c.gauge_controls:5}"
    )
    assert (c.dimension, c.rank) == (known.dimension, known.rank)
    assert ((c.k_f, c.k_f_base), c.gauge_controls) == (
        known.levels,
        known.gauge,
    )


def motion(name, start, time, gauge=None):
    """The motion on the manifold from one of its points, in 120 steps."""
    problem = found[name].problem
    step = rx.Midpoint(default_retraction(problem.manifold))
    method, choice = singular_integrator(found[name], step, gauge=gauge)
    print(choice)
    return rx.integrate(problem, method, start, time / 120, 120)


# %%
# The problem of Aly and Chan
# ---------------------------
# On :math:`P_f` the state is an oscillator. From :math:`(0, 1)` the control is
# :math:`u = -\sin t`, and the cost up to the time :math:`\pi/2` is zero:
#
# .. math::
#
#    \dot x_1 = x_2, \quad \dot x_2 = u, \qquad
#    \text{minimise } \int \tfrac12 (x_2^2 - x_1^2)\,dt
start = jnp.array([0.0, 1.0]), jnp.array([1.0, 0.0])
path = motion("aly-chan", start, np.pi / 2)
t, u = path.stage_times, path.controls[:, 0]
cost = np.trapezoid((path.q[:, 1] ** 2 - path.q[:, 0] ** 2) / 2, path.times)
error = np.max(np.abs(u + np.sin(t)))
print(f"error of the control {error:.1e}, cost {cost:.1e}")
assert max(error, abs(cost)) <= 5e-5

figure, axis = plt.subplots(figsize=(7, 3.5), layout="constrained")
axis.plot(path.times, path.q, label=["$x_1$", "$x_2$"])
axis.plot(t, u, label="$u$")
axis.plot(t, -np.sin(t), "k:", label=r"$-\sin t$")
axis.set(xlabel="time")
axis.legend()

# %%
# A charged particle without mass
# -------------------------------
# The momentum is :math:`p = A(q)`. The particle drifts along the level lines of
# its potential energy :math:`V = x^2/2 + y^2`:
#
# .. math::
#
#    \dot q = (-2y, x)/\operatorname{curl} A
start = jnp.array([0.6, 0.0]), jnp.array([0.0, 0.3 * (1 + 0.36)])
path = motion("massless particle", start, 8.0)
x, y = np.asarray(path.q).T
potential = ((1 + x**2 + y**2) / 2 * np.stack([-y, x])).T
change, missed = np.ptp(x**2 / 2 + y**2), np.max(np.abs(path.p - potential))
print(f"change of V {change:.1e}, distance from p = A(q) {missed:.1e}")
assert max(change, missed) <= 3e-4

angle = np.linspace(0, 2 * np.pi, 200)
figure, axis = plt.subplots(figsize=(5, 4), layout="constrained")
axis.plot(x, y, ".", label="nodes")
ellipse = 0.6 * np.cos(angle), 0.6 / np.sqrt(2) * np.sin(angle)
axis.plot(*ellipse, "k:", label="level line")
axis.set(xlabel="$x$", ylabel="$y$", aspect="equal")
axis.legend()

# %%
# The Lagrangian of Brown
# -----------------------
# This Lagrangian with four degrees of freedom has all four classes of
# equations. The difference :math:`q_4 - q_2` is :math:`\cos t` for every gauge
# control:
start = jnp.array([-1.0, 0.0, 0.0, 1.0]), jnp.zeros(4)
gauges = {
    "0": lambda t, q, p: jnp.zeros(1),
    r"\cos 3t": lambda t, q, p: jnp.cos(3 * t)[None],
}
figure, axis = plt.subplots(figsize=(7, 3.5), layout="constrained")
differences = []
for name, gauge in gauges.items():
    path = motion("brown", start, 2 * np.pi, gauge)
    differences.append(np.asarray(path.q[:, 3] - path.q[:, 1]))
    axis.plot(path.times, path.q[:, 1], "--", label=f"$q_2$, gauge ${name}$")
axis.plot(path.times, differences[0], label="$q_4 - q_2$")
axis.set(xlabel="time")
axis.legend()
error = np.max(np.abs(differences - np.cos(path.times)))
seen = np.max(np.abs(differences[0] - differences[1]))
print(f"error {error:.1e}, change by the gauge {seen:.1e}")
assert error <= 2e-3
assert seen <= 1e-13

# %%
# A free control
# --------------
# For :math:`H = p_1 x_2 + p_2 u` the manifold is :math:`p = 0`, with a zero
# form. So every motion with :math:`\dot x_1 = x_2` is an extremal. With the
# gauge control :math:`\cos t` the motion is :math:`x_1 = 1 - \cos t`:
start = jnp.zeros(2), jnp.zeros(2)
path = motion("gauge", start, 2 * np.pi, lambda t, q, p: jnp.cos(t)[None])
error = np.max(np.abs(path.q[:, 0] - (1 - np.cos(path.times))))
print(f"error {error:.1e}, largest p {np.max(np.abs(path.p)):.1e}")
assert error <= 5e-4
assert np.max(np.abs(path.p)) <= 1e-14

figure, axis = plt.subplots(figsize=(7, 3.5), layout="constrained")
axis.plot(path.times, path.q, label=["$x_1$", "$x_2$"])
axis.plot(path.times, 1 - np.cos(path.times), "k:", label=r"$1 - \cos t$")
axis.set(xlabel="time")
axis.legend()

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
