"""Problems in R^n with limits on controls or states: controls that switch, that are singular, that chatter."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ..integrators import Free, OptimalControlProblem
from ..manifolds import Euclidean
from .flat import BRYSON, COPS, LINE, MOTION, PLANE, double_integrator
from .geodesics import energy, time
from .record import KnownProblem, register


@register
def least_time() -> KnownProblem:
    """The double integrator from rest to rest in least time."""
    return KnownProblem(
        name="least-time",
        title="the double integrator from rest to rest in least time",
        equations=(
            r"\text{minimise } T",
            r"\dot x = v, \quad \dot v = u",
            r"\lvert u\rvert \le 1",
        ),
        problem=OptimalControlProblem(PLANE, double_integrator, time, 1, control_bounds=(-1.0, 1.0)),
        start=np.zeros(2),
        end=np.array([1.0, 0.0]),
        horizon=Free(3.0, lower=0.1),
        states=MOTION,
        controls={"u": "acceleration"},
        source=f"{BRYSON}, section 3.9",
        optimum=2.0,
        digits=12,
        origin="closed form: $u = 1$ until half-time, then $u = -1$",
        formula=r"2\sqrt d",
        error=1e-8,
    )


@register
def turnpike() -> KnownProblem:
    """Bang, singular, bang."""
    return KnownProblem(
        name="turnpike",
        title="to a singular arc and away from it",
        equations=(
            r"\text{minimise } \int_0^T x^2\,dt",
            r"\dot x = u",
            r"\lvert u\rvert \le 1",
        ),
        problem=OptimalControlProblem(LINE, lambda q, u: u, lambda q, u: q @ q, 1, control_bounds=(-1.0, 1.0)),
        start=np.ones(1),
        end=np.array([0.5]),
        horizon=2.0,
        states={"x": "1"},
        controls={"u": "1"},
        source="E. Trelat, E. Zuazua, The turnpike property in finite-dimensional nonlinear optimal control, J. "
        "Differential "
        "Equations 258, 2015, 81-114",
        optimum=3 / 8,
        digits=12,
        origin=r"closed form: $u = -1, 0, 1$ with switches at $t = 1$ and $t = \tfrac32$",
        formula=r"\tfrac38",
    )


@register
def aly_chan() -> KnownProblem:
    """Aly and Chan's problem, singular all along."""

    def dynamics(q: Array, u: Array) -> Array:
        return jnp.stack([q[1], u[0], (q[1] ** 2 - q[0] ** 2) / 2])

    return KnownProblem(
        name="aly-chan",
        title="a control that is singular all along",
        equations=(
            r"\text{minimise } x_3(T)",
            r"\dot x_1 = x_2, \quad \dot x_2 = u, \quad \dot x_3 = \tfrac12 (x_2^2 - x_1^2)",
            r"\lvert u\rvert \le 1",
        ),
        problem=OptimalControlProblem(
            Euclidean(3), dynamics, lambda q, u: 0.0 * q[0], 1, terminal_cost=lambda q: q[2], control_bounds=(-1.0, 1.0)
        ),
        start=np.array([0.0, 1.0, 0.0]),
        end=None,
        horizon=np.pi / 2,
        states={"x1": "1", "x2": "1", "x3": "cost so far"},
        controls={"u": "1"},
        source="G. M. Aly, W. C. Chan, Application of a modified quasilinearization technique to totally singular "
        "optimal control "
        "problems, Internat. J. Control 17, 1973, 809-815",
        optimum=0.0,
        digits=12,
        origin=r"closed form: $u = -\sin t$",
        formula="0",
        error=1e-8,
    )


@register
def bryson_denham() -> KnownProblem:
    """A state inequality of second order."""
    limit = 1 / 9
    return KnownProblem(
        name="bryson-denham",
        title="the double integrator below a ceiling",
        equations=(
            r"\text{minimise } \tfrac12 \int_0^T u^2\,dt",
            r"\dot x = v, \quad \dot v = u",
            r"x \le \tfrac19",
        ),
        problem=OptimalControlProblem(
            PLANE, double_integrator, energy, 1, constraints={"ceiling": lambda q, u: q[0] - limit}
        ),
        start=np.array([0.0, 1.0]),
        end=np.array([0.0, -1.0]),
        horizon=1.0,
        steps=60,
        states=MOTION,
        controls={"u": "acceleration"},
        source="A. E. Bryson, W. F. Denham, S. E. Dreyfus, Optimal programming problems with inequality constraints "
        "I, AIAA J. 1, "
        "1963, 2544-2550",
        optimum=4 / (9 * limit),
        digits=12,
        origin=r"closed form, on the ceiling from $t = \tfrac13$ to $t = \tfrac23$",
        formula=r"\frac{4}{9 l}",
        accuracy=1e-9,
    )


@register
def van_der_pol() -> KnownProblem:
    """The oscillator of van der Pol, with limits."""

    def dynamics(q: Array, u: Array) -> Array:
        return jnp.stack([(1 - q[1] ** 2) * q[0] - q[1] + u[0], q[0]])

    return KnownProblem(
        name="van-der-pol",
        title="van der Pol's oscillator with a limited control and a limited state",
        equations=(
            r"\text{minimise } \int_0^T x_1^2 + x_2^2 + u^2\,dt",
            r"\dot x_1 = (1 - x_2^2)\,x_1 - x_2 + u, \quad \dot x_2 = x_1",
            r"\lvert u\rvert \le 1, \quad x_1 \ge -\tfrac14",
        ),
        problem=OptimalControlProblem(
            PLANE,
            dynamics,
            lambda q, u: q @ q + u @ u,
            1,
            control_bounds=(-1.0, 1.0),
            constraints={"x1": lambda q, u: -0.25 - q[0]},
        ),
        start=np.array([0.0, 1.0]),
        end=None,
        horizon=10.0,
        steps=60,
        states={"x1": "1", "x2": "1"},
        controls={"u": "1"},
        source="J. Andersson, J. Gillis, G. Horn, J. Rawlings, M. Diehl, CasADi: a software framework for nonlinear "
        "optimization and "
        "optimal control, Math. Prog. Comp. 11, 2019, 1-36, section 6",
        optimum=3.615181368,
        digits=10,
        origin="limit of the discrete optima here as the steps shrink, and collocation of order 6 with IPOPT",
        accuracy=1e-9,
    )


@register
def fuller() -> KnownProblem:
    """Fuller's problem: the optimal control switches infinitely often before it comes to rest."""
    return KnownProblem(
        name="fuller",
        title="infinitely many switches in finite time",
        equations=(
            r"\text{minimise } \tfrac12 \int_0^T x^2\,dt",
            r"\dot x = v, \quad \dot v = u",
            r"\lvert u\rvert \le 1",
        ),
        problem=OptimalControlProblem(
            PLANE, double_integrator, lambda q, u: q[0] ** 2 / 2, 1, control_bounds=(-1.0, 1.0)
        ),
        start=np.array([0.0, 1.0]),
        end=np.zeros(2),
        horizon=5.0,
        steps=60,
        states=MOTION,
        controls={"u": "acceleration"},
        source="A. T. Fuller, Study of an optimum non-linear control system, J. Electronics and Control 15, 1963, "
        "63-71",
        optimum=0.134196915284,
        digits=12,
        origin=r"closed form: a finite arc and a self-similar chattering arc, which switches where "
        r"$x = -0.44462\,v \lvert v\rvert$",
        accuracy=1e-9,
    )


@register
def catalyst_mixing() -> KnownProblem:
    """Two catalysts along a tubular reactor: bang, singular, bang."""

    def dynamics(q: Array, u: Array) -> Array:
        a, b = u[0] * (10 * q[1] - q[0]), (1 - u[0]) * q[1]
        return jnp.stack([a, -a - b])

    return KnownProblem(
        name="catalyst-mixing",
        title="the best mixture of two catalysts along a reactor",
        equations=(
            r"\text{minimise } x_1(T) + x_2(T) - 1",
            r"\dot x_1 = u\,(10 x_2 - x_1), \quad \dot x_2 = -u\,(10 x_2 - x_1) - (1 - u)\,x_2",
            r"0 \le u \le 1",
        ),
        problem=OptimalControlProblem(
            PLANE,
            dynamics,
            lambda q, u: 0.0 * q[0],
            1,
            terminal_cost=lambda q: q[0] + q[1] - 1,
            control_bounds=(0.0, 1.0),
        ),
        start=np.array([1.0, 0.0]),
        end=None,
        horizon=1.0,
        steps=60,
        states={"x1": "fraction of the first substance", "x2": "of the second"},
        controls={"u": "fraction of the first catalyst"},
        source=f"{COPS}, 14; R. Jackson, Optimization of chemical reactions, J. Optim. Theory Appl. 2, 1968",
        optimum=-0.04805569,
        digits=7,
        origin="limit of the discrete optima here as the steps shrink; published as 0.0480556",
        error=1e-5,
    )


@register
def fishing() -> KnownProblem:
    """Predators and prey are fished towards their balance: bang, singular, bang."""

    def dynamics(q: Array, u: Array) -> Array:
        x, y = q
        return jnp.stack([x - x * y - 0.4 * x * u[0], -y + x * y - 0.2 * y * u[0]])

    return KnownProblem(
        name="fishing",
        title="predators and prey are fished towards their balance",
        equations=(
            r"\text{minimise } \int_0^T (x - 1)^2 + (y - 1)^2\,dt",
            r"\dot x = x - x y - 0.4\,x u, \quad \dot y = -y + x y - 0.2\,y u",
            r"0 \le u \le 1",
        ),
        problem=OptimalControlProblem(PLANE, dynamics, lambda q, u: (q - 1) @ (q - 1), 1, control_bounds=(0.0, 1.0)),
        start=np.array([0.5, 0.7]),
        end=None,
        horizon=12.0,
        steps=60,
        states={"x": "prey", "y": "predators"},
        controls={"u": "fishing"},
        source="S. Sager, H. G. Bock, M. Diehl, G. Reinelt, J. P. Schloder, Numerical methods for optimal control "
        "with binary control "
        "functions applied to a Lotka-Volterra type fishing problem, Lecture Notes in Economics 563, 2006, 269-289",
        optimum=1.344081198,
        digits=10,
        origin="published as 1.34408, of the relaxed problem; arcs with free switching times, on several meshes",
        error=5e-5,
    )
