r"""
Pendulum on a cart
==================

A cart moves in the plane, pushed by a force :math:`F`. A rod hangs from it by a
joint that lets it swing in every direction. The cart swings the rod up and
catches it upright, although the weight at the end of the rod is heavier than
planned, the cart is disturbed, and the measurements are noisy. With the cart at
:math:`x`, the direction :math:`q` of the rod, and its shadow :math:`y = C q` in
the plane, :math:`C = (I_2\ 0)`:

.. math::

    (M I + m\,y y^\top)\,\ddot x &= F + m\,(L \lvert\dot q\rvert^2 - g q_3)\,y

    \ddot q &= -\lvert\dot q\rvert^2 q
    - (I - q q^\top)(C^\top \ddot x + g e_3) / L

The model is that of Lee, Leok and McClamroch, *Dynamics and control of a chain
pendulum on a cart* (2012), with one link. The rod is a point of the sphere, so
no direction is singular.
"""

# %%
# The model
# ---------
# The state is the position and the velocity of the cart, and a point of the
# tangent bundle of the sphere: the direction of the rod and its velocity.
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import retrax as rx
from retrax.manifolds import TangentBundle

jax.config.update("jax_enable_x64", True)

CART, WEIGHT, LENGTH, GRAVITY = 1.0, 0.3, 0.5, 9.81  # kg, kg, m, m/s^2
PLANNED, MOST, TRACK = 6.0, 8.0, 1.0  # N, N, m
Q = rx.Euclidean(2) * rx.Euclidean(2) * TangentBundle(rx.Sphere(2))


def move(q, F, m):
    _, v, (rod, w) = q
    y, s = rod[:2], w @ w
    push = F + m * (LENGTH * s - GRAVITY * rod[2]) * y
    a = jnp.linalg.solve(CART * jnp.eye(2) + m * jnp.outer(y, y), push)
    pull = jnp.append(a, GRAVITY) / LENGTH
    return v, a, (w, -s * rod - pull + (pull @ rod) * rod)


def energy(q, m):
    _, v, (rod, w) = q
    tip = jnp.append(v, 0.0) + LENGTH * w
    kinetic = CART * v @ v / 2 + m * tip @ tip / 2
    return kinetic + m * GRAVITY * LENGTH * rod[2]


def with_limit(force):
    return rx.OptimalControlProblem(
        Q,
        lambda q, F: move(q, F, WEIGHT),
        lambda q, F: F @ F / 2,
        controls=2,
        control_bounds=(-force, force),
        constraints={"track": lambda q, F: q[0] @ q[0] / TRACK**2 - 1},
        labels={
            "states": ("cart", "cart velocity", "rod", "rod velocity"),
            "controls": ("force x", "force y"),
        },
        units={
            "states": ("m", "m/s", "", "1/s"),
            "controls": "N",
            "time": "s",
        },
    )


# %%
# The swing
# ---------
# The plan keeps 2 of the 8 N for the controller. The cart begins half a metre
# from its target. The guess swings the rod to one side by 35 degrees, to the
# other side by 85 degrees, and up. Without a guess the solver finds the same
# plan, with ten times as many iterations.
DURATION, LAST = 2.5, 5.0  # s
method = rx.Gauss(2, rx.default_retraction(Q))
side = np.array([1.0, 0.7]) / np.hypot(1.0, 0.7)


def rest(degrees, x):
    """The cart at a place, and the rod at an angle from below, at rest."""
    sine, cosine = np.sin(np.deg2rad(degrees)), np.cos(np.deg2rad(degrees))
    rod = np.append(sine * side, -cosine)
    return np.array([x, 0.0]), np.zeros(2), (rod, np.zeros(3))


hanging, upright = rest(0, 0.5), rest(180, 0.0)
swings = rest(35, 0.25), rest(0, -0.1), rest(-85, -0.3), rest(0, 0), rest(85, 0)
problem = with_limit(PLANNED)
guess = rx.Guess.from_waypoints(
    problem,
    method,
    [hanging, *swings, upright],
    60,
    times=[0.0, 0.5, 0.75, 1.17, 1.56, 1.85, DURATION],
)
solver = rx.Solver(problem, method, steps=60)
plan = solver.solve(hanging, upright, DURATION, guess=guess)
print(f"plan: {plan.statistics.iterations} iterations, {plan.status}")

# %%
# The controller
# --------------
# A receding horizon controller follows the plan 25 times a second, and stays
# upright after its end. The directions of the basis on a sphere are arbitrary,
# so the rod and its velocity have equal weights.
SAMPLE = 0.04  # s
weights = np.repeat([50.0, 5.0, 50.0], [2, 2, 4])
follow = rx.tracking(
    with_limit(MOST),
    plan,
    weights=weights,
    control_weights=0.1,
    end_weights=weights,
    outside="constant",
)
controller = rx.RecedingHorizon(
    rx.Solver(follow, method, steps=10),
    end=None,
    horizon=1.0,
    max_iterations=20,
    hold=SAMPLE,
)

# %%
# The loop
# --------
# The weight has 20 percent more mass than in the plan, and an unknown force
# pushes the cart. The direction of the rod is measured to 0.3 degrees.
plant = rx.OptimalControlProblem(
    Q,
    lambda q, F, unknown: move(q, F + unknown, 1.2 * WEIGHT),
    lambda q, F: F @ F / 2,
    controls=2,
    control_bounds=(-MOST, MOST),
    labels=follow.quantities,
)


def disturb(t, rng):
    return np.array([0.2, -0.1]) + 0.2 * rng.normal(size=2)


def measure(q, t, rng):
    x, v, (rod, w) = q
    rod = rod + 0.005 * rng.normal(size=3)
    rod = rod / np.linalg.norm(rod)
    w = w + 0.02 * rng.normal(size=3)
    x, v = x + 0.002 * rng.normal(size=2), v + 0.01 * rng.normal(size=2)
    return x, v, (rod, w - (w @ rod) * rod)


loop = rx.simulate(
    plant,
    controller,
    hanging,
    horizon=LAST,
    sample_time=SAMPLE,
    parameters=disturb,
    measure=measure,
)
print(loop.solves)

# %%
# The path of the weight beside the plan, and the rod every 0.12 s, from blue to
# red:
x, _, (rod, _) = loop.q
cart = np.column_stack([x, np.zeros(len(x))])
planned = plan.q[2][0] * LENGTH + np.pad(plan.q[0], [(0, 0), (0, 1)])
figure = plt.figure(figsize=(7, 6), layout="constrained")
axis = figure.add_subplot(projection="3d")
axis.plot(*planned.T, color="k", linestyle="--", linewidth=1, label="plan")
axis.plot(*(cart + LENGTH * rod).T, color="0.6", label="weight")
for k in range(0, len(x), 3):
    ends = np.stack([cart[k], cart[k] + LENGTH * rod[k]])
    axis.plot(*ends.T, color=plt.cm.coolwarm(k / len(x)))
axis.set_aspect("equal")
axis.set(xlabel="x [m]", ylabel="y [m]", zlabel="z [m]")
axis.legend()

# %%
# The angle to the upright direction, the way of the cart, and the forces:
angle = np.rad2deg(np.arccos(np.clip(rod[:, 2], -1, 1)))
figure, axes = plt.subplots(3, figsize=(8, 8), layout="constrained")
axes[0].plot(loop.t, angle)
axes[0].set_ylabel("angle [deg]")
axes[1].plot(loop.t, np.linalg.norm(x, axis=1))
axes[1].axhline(TRACK, color="k", linestyle="--")
axes[1].set_ylabel("distance of the cart [m]")
rx.plotting.controls(loop, ax=axes[2])
axes[2].set_ylabel("force [N]")

# %%
# The numbers
# -----------
# The energy changes at the rate at which the force works, as in every
# mechanical system.
WITHOUT_GUESS = 20.698079  # N^2 s, the cost of the plan without a guess


def change(q, F):
    """The rate of the energy minus the power of the force, in W."""
    velocity = move(q, F, WEIGHT)
    rate = jax.jvp(lambda q: energy(q, WEIGHT), (q,), (velocity,))[1]
    return rate - F @ q[1]


rates = jax.vmap(change)(plan.stage_states, plan.controls)
caught = loop.t >= 3.0
print(f"energy: rate minus power at most {jnp.abs(rates).max():.1e} W")
print(f"cart at most {np.linalg.norm(x, axis=1).max():.2f} m away")
print(f"after 3 s at most {angle[caught].max():.1f} degrees from upright")
assert plan.checks.strict_minimum
assert abs(plan.cost / WITHOUT_GUESS - 1) <= 1e-6
assert jnp.abs(rates).max() <= 1e-12
assert np.abs(plan.controls).max() <= PLANNED
assert np.abs(loop.u).max() <= MOST
assert np.linalg.norm(x, axis=1).max() <= TRACK
assert angle[caught].max() <= 5
assert np.linalg.norm(x, axis=1)[caught].max() <= 0.2
assert loop.solves.fallbacks == 0

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
