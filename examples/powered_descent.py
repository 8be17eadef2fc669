r"""
Powered descent on Mars
=======================

A lander of 1905 kg lands on Mars with least fuel, from 1500 m above the ground
and 2062 m aside, where it flies with 125 m/s. Six thrusters give 4.97 to 13.26
kN together and cannot be off. With the thrust :math:`u`, its bound
:math:`\Gamma` and the mass flow :math:`\alpha` of a unit of thrust:

.. math::

    \text{minimise } \int_0^T \alpha\,\Gamma\,dt, \qquad
    \dot r = v, \quad \dot v = g + \frac{u}{m}, \quad \dot m = -\alpha\,\Gamma,
    \qquad \lvert u\rvert \le \Gamma, \quad
    \Gamma_{\min} \le \Gamma \le \Gamma_{\max}

The glide slope is a cone: the path stays 4 degrees above the horizon of the
target. The lander is that of B. Acikmese and S. R. Ploen, *Convex programming
approach to powered descent guidance for Mars landing*, J. Guidance Control
Dynam. 30, 2007. The start is that of L. Blackmore, B. Acikmese and D. P.
Scharf, *Minimum-landing-error powered-descent guidance for Mars landing using
convex optimization*, J. Guidance Control Dynam. 33, 2010.
"""

# %%
# The problem
# -----------
# The thrusters are canted by 27 degrees, so part of the fuel does not lift. The
# bound :math:`\Gamma` is a control too. In an optimum the thrust reaches it.
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import retrax as rx

jax.config.update("jax_enable_x64", True)

cant = np.cos(np.deg2rad(27))
least, most = np.array([0.3, 0.8]) * 6 * 3.1 * cant  # kN
flow = 1e3 / (225 * 9.807 * cant)  # kg/s for 1 kN, specific impulse 225 s
gravity = np.array([0, 0, -3.7114])  # m/s^2
slope = np.tan(np.deg2rad(4))

Q = (
    rx.Euclidean(3) * rx.Euclidean(3) * rx.Euclidean(1)
)  # position, velocity, mass


def dynamics(q, u):
    _, v, m = q
    return v, gravity + 1e3 * u[:3] / m, -flow * u[3:]


def below_the_slope(q, u):
    r = q[0]
    return slope * jnp.linalg.norm(r[:2]) - r[2]


def landing(constraints):
    free = np.inf
    return rx.OptimalControlProblem(
        Q,
        dynamics,
        running_cost=lambda q, u: flow * u[3],
        controls=4,
        control_bounds=([-free] * 3 + [least], [free] * 3 + [most]),
        constraints={
            "thrust": lambda q, u: u[:3] @ u[:3] - u[3] ** 2,
            **constraints,
        },
        labels={
            "states": ("position", "velocity", "mass"),
            "controls": ("x", "y", "z", "size"),
        },
        units={
            "states": ("m", "m/s", "kg"),
            "controls": "kN",
            "time": "s",
            "cost": "kg",
        },
    )


# %%
# The landing
# -----------
# The final time is free.
start = (
    np.array([2000.0, 500, 1500]),
    np.array([100.0, 0, -75]),
    np.array([1905.0]),
)
end = np.zeros(3), np.zeros(3), None
horizon = rx.Free(75.0, lower=40, upper=120)
problem = landing({"glide slope": below_the_slope})
solution = rx.solve(problem, start, end, horizon, steps=40, accuracy=1e-5)
solution.report()

# %%
# The paths
# ---------
# Without the glide slope the lander takes less fuel, and flies below the
# ground. The picture shows both paths, the thrust every 5 s and a part of the
# cone.
diving = rx.solve(landing({}), start, end, horizon, steps=40)
figure = plt.figure(figsize=(9, 4.5))
axis = figure.add_axes([-0.05, -0.54, 1.05, 2.1], projection="3d")
rx.plotting.path({"glide slope": solution, "without": diving}, ax=axis)
(r, _, _), u, _ = solution(np.arange(0, solution.horizon, 5))[1:]
axis.quiver(*r.T, *(30 * u[:, :3].T), color="C3", linewidth=1)
angle, far = np.meshgrid(np.linspace(-0.4, 0.7, 60), [0, 3400])
cone = far * np.cos(angle), far * np.sin(angle), slope * far
axis.plot_surface(*cone, color="C2", alpha=0.2)
axis.view_init(12, -65)
axis.get_legend().remove()
figure.legend(loc="upper left")

# %%
# The thrust
# ----------
# The size of the thrust is at its upper bound, then at its lower bound, then at
# its upper bound again.
rx.plotting.controls(solution).set_ylabel("thrust [kN]")

# %%
# The numbers
# -----------
# Blackmore, Acikmese and Scharf publish 399.4 kg and a final time of 78.4 s,
# from 55 points and a line search that stopped within 3 s. IPOPT finds
# 398.799 kg with three phases of 80 steps of Gauss collocation.
print(f"fuel {solution.cost:.2f} kg in {solution.horizon:.2f} s")
print(f"without the glide slope {diving.cost:.2f} kg in {diving.horizon:.2f} s")
print(f"lowest point without it {diving.q[0][:, 2].min():.0f} m")
IPOPT = 398.799  # kg
u = solution.u
assert solution.checks.strict_minimum
assert diving.checks.strict_minimum
assert np.allclose(np.linalg.norm(u[:, :3], axis=1), u[:, 3]), (
    "the bound is met"
)
assert solution.q[0][:, 2].min() >= 0
assert abs(solution.cost / IPOPT - 1) <= 1e-5
assert abs(solution.cost - 399.4) <= 1  # kg

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
