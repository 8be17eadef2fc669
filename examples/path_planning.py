r"""
Path planning past obstacles
============================

A rigid body moves between two poses past a ball. A path that pymanopt plans
starts the optimal control solver. The cost is the kinetic energy of the motion,
plus a barrier :math:`b` around a ball with the centre :math:`c` and the radius
:math:`r`:

.. math::

    \dot x = x\,\hat\xi, \qquad
    \text{minimise } \int_0^1 \tfrac12 (J \lvert\omega\rvert^2
    + m \lvert v\rvert^2) + b(p)\,dt, \qquad
    b(p) = W\,e^{S (1 - \lvert p - c\rvert^2/r^2)}

on :math:`SE(3)`, with the pose :math:`x = (R, p)` and the twist
:math:`\xi = (\omega, v)` in the body frame.
"""

# %%
# The problem
# -----------
# The straight way would cross the ball.
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import pymanopt
import retrax as rx
from retrax.interop import to_pymanopt
from retrax.manifolds import Power
from retrax.retractions import PowerRetraction, SEDecoupled

jax.config.update("jax_enable_x64", True)

Q = rx.SE(3)
INERTIA, MASS, STEPS = 0.5, 1.0, 40
CENTRE, RADIUS = np.array([0.0, -0.3, 0.0]), 1.0
STRAIGHT = SEDecoupled(Q)
ANGLE, WAY = np.deg2rad(120), np.array([4.0, 0.0, 0.0])
TURN = rx.hat(np.ones(3) * ANGLE / np.sqrt(3))
START = Q.pose(np.eye(3), np.array([-2.0, 0.0, 0.0]))
END = STRAIGHT(START, Q.tangent(TURN, WAY))


def barrier(pose):
    """Cost rate near the ball."""
    away = Q.parts(pose)[1] - CENTRE
    return 2.0 * jnp.exp(10.0 * (1 - away @ away / RADIUS**2))


def energy_rate(pose, twist):
    """Kinetic energy, and the barrier."""
    omega, v = twist[:3], twist[3:]
    return (INERTIA * omega @ omega + MASS * v @ v) / 2 + barrier(pose)


problem = rx.OptimalControlProblem(
    Q, lambda pose, twist: pose @ Q.hat(twist), energy_rate, controls=6
)

# %%
# The planned path
# ----------------
# The inner nodes of a path are one point of a power of :math:`SE(3)`. The trust
# region method of pymanopt minimises the discrete energy over this point.


def path_energy(nodes, weight):
    """Discrete energy, and a weight times the barrier."""
    path = jnp.concatenate([START[None], nodes, END[None]])
    turns, shifts = jax.vmap(Q.parts)(path[1:] - path[:-1])
    kinetic = INERTIA * jnp.sum(turns**2) / 2 + MASS * jnp.sum(shifts**2)
    return STEPS * kinetic / 2 + weight * jnp.mean(jax.vmap(barrier)(path))


def plan(weight):
    """The path of least energy from the geodesic, and its energy."""
    space = to_pymanopt(
        Power(Q, STEPS - 1), PowerRetraction(STRAIGHT, STEPS - 1)
    )
    cost = pymanopt.function.jax(space)(lambda x: path_energy(x, weight))
    tangent = STRAIGHT.inverse(START, END)
    nodes = [STRAIGHT(START, k / STEPS * tangent) for k in range(1, STEPS)]
    optimizer = pymanopt.optimizers.TrustRegions(
        verbosity=0, max_iterations=200, min_gradient_norm=1e-7
    )
    result = optimizer.run(
        pymanopt.Problem(space, cost), initial_point=np.stack(nodes)
    )
    return np.concatenate([START[None], result.point, END[None]]), result.cost


# %%
# Without the barrier the optimal path is a straight line with a constant rate
# of turn. Its discrete energy is known:
#
# .. math::
#
#    J N^2 (1 - \cos(\alpha/N)) + \tfrac12 m \lvert d\rvert^2
geodesic, energy = plan(0.0)
exact = INERTIA * STEPS**2 * (1 - np.cos(ANGLE / STEPS)) + MASS * WAY @ WAY / 2
print(f"without the ball: energy {energy:.10f}, known {exact:.10f}")
assert abs(energy / exact - 1) <= 1e-10
path, energy = plan(1.0)
print(f"with the ball: energy {energy:.4f}")

# %%
# The optimal motion
# ------------------
# The guess has the poses midway between the nodes, and the twists that lead
# from one node to the next.
exponential = rx.Exponential(Q)
tangents = jax.vmap(exponential.preimage)(path[:-1], path[1:])
middles = jax.vmap(lambda x, v: exponential(x, v / 2))(path[:-1], tangents)
twists = jax.vmap(lambda x, v: Q.vee(Q.left_trivialise(x, v)))(
    path[:-1], tangents
)
solution = rx.solve(
    problem,
    START,
    END,
    1.0,
    method=rx.Midpoint(exponential),
    steps=STEPS,
    guess=rx.Guess(middles, STEPS * twists),
)
print(solution.result)
axis = rx.plotting.path(solution, obstacles=[(CENTRE, RADIUS)])
axis.view_init(50, -70)

# %%
# The length
# ----------
# The way is longer than a string that is pulled taut around the ball: two
# tangents and an arc. The figure compares the distances to the centre:
ends = [Q.parts(pose)[1] - CENTRE for pose in (START, END)]
far = np.linalg.norm(ends, axis=1)
angle = np.arccos(ends[0] @ ends[1] / np.prod(far))
arc = angle - np.sum(np.arccos(RADIUS / far))
taut = np.sum(np.sqrt(far**2 - RADIUS**2)) + RADIUS * arc
figure, axis = plt.subplots(layout="constrained")
for name, poses in {
    "geodesic": geodesic,
    "planned path": path,
    "optimal motion": solution.states,
}.items():
    places = np.asarray(poses)[:, :3, 3]
    away = np.linalg.norm(places - CENTRE, axis=1)
    length = np.sum(np.linalg.norm(np.diff(places, axis=0), axis=1))
    print(f"{name}: length {length:.4f}, comes to {away.min():.4f}")
    axis.plot(np.linspace(0, 1, len(poses)), away, label=name)
axis.axhline(RADIUS, color="k", linestyle=":", label="the ball")
axis.set(xlabel="time", ylabel="distance to the centre")
axis.legend()
print(f"taut string: length {taut:.4f}")
assert solution.checks.strict_minimum
assert away.min() >= RADIUS
assert 1 <= length / taut <= 1.05

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
