"""Problems in R^n that every solver is shown with, without limits on controls and states."""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from scipy.optimize import root_scalar

from ..integrators import Free, OptimalControlProblem
from ..manifolds import Euclidean
from .attitude import BETTS
from .geodesics import energy, time
from .record import KnownProblem, register

BRYSON = "A. E. Bryson, Y.-C. Ho, Applied Optimal Control, 1975"
COPS = "E. D. Dolan, J. J. More, T. S. Munson, Benchmarking optimization software with COPS 3.0, ANL/MCS-TM-273, 2004"
LINE, PLANE = Euclidean(1), Euclidean(2)
MOTION = {"x": "position", "v": "velocity"}


def double_integrator(q: Array, u: Array) -> Array:
    """``x' = v``, ``v' = u``."""
    return jnp.stack([q[1], u[0]])


@register
def regulator() -> KnownProblem:
    """The scalar regulator."""
    return KnownProblem(
        name="regulator",
        title="the scalar linear-quadratic regulator",
        equations=(
            r"\text{minimise } \tfrac12 \int_0^T x^2 + u^2\,dt",
            r"\dot x = u",
        ),
        problem=OptimalControlProblem(LINE, lambda q, u: u, lambda q, u: (q @ q + u @ u) / 2, 1),
        start=np.ones(1),
        end=None,
        horizon=1.0,
        states={"x": "1"},
        controls={"u": "1"},
        source=f"{BRYSON}, chapter 5",
        optimum=float(np.tanh(1.0) / 2),
        digits=12,
        origin=r"closed form: $u = -\tanh(1 - t)\,x$",
        formula=r"\tfrac12 \tanh T",
    )


@register
def least_effort() -> KnownProblem:
    """The double integrator from rest to rest."""
    return KnownProblem(
        name="least-effort",
        title="the double integrator from rest to rest with least effort",
        equations=(
            r"\text{minimise } \tfrac12 \int_0^T u^2\,dt",
            r"\dot x = v, \quad \dot v = u",
        ),
        problem=OptimalControlProblem(PLANE, double_integrator, energy, 1),
        start=np.zeros(2),
        end=np.array([1.0, 0.0]),
        horizon=1.0,
        steps=5,
        states=MOTION,
        controls={"u": "acceleration"},
        source=f"{BRYSON}, section 5.2",
        optimum=6.0,
        digits=12,
        origin="closed form: $u = 6 - 12t$",
        formula=r"\frac{6 d^2}{T^3}",
    )


@register
def brachistochrone() -> KnownProblem:
    """The curve of quickest descent, a cycloid."""
    gravity, (across, down) = 9.80665, (10.0, 5.0)

    def dynamics(q: Any, u: Array) -> Any:
        _, v = q
        return v[0] * jnp.stack([jnp.sin(u[0]), jnp.cos(u[0])]), gravity * jnp.cos(u[0])[None]

    turn = root_scalar(lambda a: (a - np.sin(a)) / (1 - np.cos(a)) - across / down, bracket=(0.1, 6.0), xtol=1e-15).root
    slope = np.arctan2(across, down)
    return KnownProblem(
        name="brachistochrone",
        title="the curve of quickest descent, 10 m aside and 5 m down",
        equations=(
            r"\text{minimise } T",
            r"\dot x = v \sin a, \quad \dot y = v \cos a, \quad \dot v = g \cos a, \quad g = 9.80665\ \mathrm{m/s^2}",
        ),
        problem=OptimalControlProblem(PLANE * LINE, dynamics, time, 1),
        start=(np.zeros(2), np.zeros(1)),
        end=(np.array([across, down]), None),
        horizon=Free(2.258, lower=0.1),
        path=lambda s: ((np.outer(s**2, [across, down]), 10 * s[:, None]), np.full((len(s), 1), slope)),
        states={"x": "aside, m", "y": "down, m", "v": "speed, m/s"},
        controls={"a": "angle of the path from the vertical, rad"},
        time="s",
        cost="s",
        source="Johann Bernoulli, Acta Eruditorum, 1696; data of R. Falck and others, dymos, J. Open Source "
        "Softw. 6, 2021, 2809",
        optimum=float(turn * np.sqrt(down / (1 - np.cos(turn)) / gravity)),
        digits=12,
        origin="closed form: a cycloid",
        formula=r"a \sqrt{r/g}, \quad x = r\,(a - \sin a), \quad y = r\,(1 - \cos a)",
    )


@register
def rayleigh() -> KnownProblem:
    """Rayleigh's oscillator."""

    def dynamics(q: Array, u: Array) -> Array:
        return jnp.stack([q[1], -q[0] + q[1] * (1.4 - 0.14 * q[1] ** 2) + 4 * u[0]])

    return KnownProblem(
        name="rayleigh",
        title="a tunnel diode oscillator is calmed",
        equations=(
            r"\text{minimise } \int_0^T u^2 + x^2\,dt",
            r"\dot x = v, \quad \dot v = -x + v\,(1.4 - 0.14\,v^2) + 4u",
        ),
        problem=OptimalControlProblem(PLANE, dynamics, lambda q, u: u @ u + q[0] ** 2, 1),
        start=np.array([-5.0, -5.0]),
        end=None,
        horizon=2.5,
        states={"x": "current", "v": "its rate"},
        controls={"u": "voltage"},
        source=f"D. H. Jacobson, D. Q. Mayne, Differential Dynamic Programming, 1970; {BETTS}, example 4.11",
        optimum=29.37607966,
        digits=10,
        origin="arcs whose ends are found, on several meshes and at orders 6 and 8; collocation of order 8 with IPOPT "
        "has 29.3760793",
        steps=40,
        accuracy=1e-9,
    )


@register
def hypersensitive() -> KnownProblem:
    """A short arc at each end of a long rest."""
    return KnownProblem(
        name="hypersensitive",
        title="two short arcs with a long rest between them",
        equations=(
            r"\text{minimise } \tfrac12 \int_0^T x^2 + u^2\,dt",
            r"\dot x = u - x^3",
        ),
        problem=OptimalControlProblem(LINE, lambda q, u: u - q**3, lambda q, u: (q @ q + u @ u) / 2, 1),
        start=np.ones(1),
        end=np.array([1.5]),
        horizon=10_000.0,
        accuracy=1e-7,
        states={"x": "1"},
        controls={"u": "1"},
        source="A. V. Rao, K. D. Mease, Dichotomic basis approach to solving hyper-sensitive optimal control "
        "problems, Automatica 35, "
        f"1999, 633-642; {BETTS}, example 4.4",
        optimum=float((np.sqrt(2) + np.arcsinh(1) - 1 + 2.25 * np.hypot(1, 2.25) + np.arcsinh(2.25) + 1.5**4) / 4),
        digits=12,
        origin="closed form up to $e^{-T}$; published as 3.36206",
        formula=r"\int_0^1 x \sqrt{1 + x^4} - x^3\,dx + \int_0^{3/2} x \sqrt{1 + x^4} + x^3\,dx",
    )


@register
def hanging_chain() -> KnownProblem:
    """A chain between two nails hangs with least potential energy."""
    length, (low, high) = 4.0, (1.0, 3.0)
    scale = root_scalar(
        lambda a: 2 * a * np.sinh(1 / (2 * a)) - np.sqrt(length**2 - (high - low) ** 2), bracket=(0.05, 5.0), xtol=1e-15
    ).root
    middle = 0.5 - scale * np.arctanh((high - low) / length)
    shift = low - scale * np.cosh(middle / scale)

    def moment(x: float) -> float:
        s = (x - middle) / scale
        return scale**2 * (s / 2 + np.sinh(2 * s) / 4) + shift * scale * np.sinh(s)

    def dynamics(q: Array, u: Array) -> Array:
        return jnp.stack([u[0], jnp.sqrt(1 + u[0] ** 2)])

    def path(s: np.ndarray) -> tuple[Any, Any]:
        slope = 4 * (high - low + 2) * (s - 0.25)
        return np.stack([low + np.cumsum(slope) / len(s), length * s], axis=1), slope[:, None]

    return KnownProblem(
        name="hanging-chain",
        title="a chain of length 4 between two nails",
        equations=(
            r"\text{minimise } \int_0^T x \sqrt{1 + u^2}\,dt",
            r"\dot x = u, \quad \dot s = \sqrt{1 + u^2}",
        ),
        problem=OptimalControlProblem(PLANE, dynamics, lambda q, u: q[0] * jnp.sqrt(1 + u[0] ** 2), 1),
        start=np.array([low, 0.0]),
        end=np.array([high, length]),
        horizon=1.0,
        steps=40,
        path=path,
        states={"x": "height", "s": "length so far"},
        controls={"u": "slope"},
        source=f"{COPS}, 4",
        optimum=float(moment(1.0) - moment(0.0)),
        digits=12,
        origin="closed form: a catenary",
        formula=r"\int_0^1 x \sqrt{1 + \dot x^2}\,dt, \quad x = c + a \cosh\frac{t - b}{a}",
    )
