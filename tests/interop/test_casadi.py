"""The discrete problem in CasADi has the optimum that ``solve`` finds, by IPOPT, and its points, controls and
costates."""

import casadi as ca
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from retrax.integrators import Free, OptimalControlProblem, solve
from retrax.interop import to_casadi
from retrax.interop.equations import equations
from retrax.manifolds import (
    SE,
    SO,
    SPD,
    SU,
    ComplexStiefel,
    Euclidean,
    FixedRank,
    Hyperbolic,
    InvalidInputError,
    NotOnManifoldError,
    Oblique,
    Simplex,
    Sphere,
    Stiefel,
    U,
)
from retrax.retractions import Cayley, Gauss, Midpoint, default_retraction

from ..integrators.problems import IDENTITY, REST, RIGID, SLEW, SLEW_END, half_square
from ..support.cases import Ellipsoid

pytestmark = pytest.mark.usefixtures("traced_once")

QUIET = {
    "ipopt.print_level": 0,
    "print_time": False,
    "ipopt.sb": "yes",
    "ipopt.tol": 1e-11,
    "ipopt.bound_relax_factor": 0.0,
}
SPHERE, MOTIONS = Sphere(2), SE(3)
TARGET = np.array([0.0, 0.6, 0.8])
SPUN = OptimalControlProblem(
    SPHERE * Euclidean(3),
    lambda q, u: (jnp.cross(q[1], q[0]), jnp.cross(q[0], jnp.array([0.0, 0.0, -1.0])) + u),
    half_square,
    3,
)
LANDED = OptimalControlProblem(
    SPHERE, lambda q, u: jnp.cross(u, q), half_square, 3, terminal_cost=lambda q: (q - TARGET) @ (q - TARGET)
)
DOCKED = OptimalControlProblem(
    MOTIONS * Euclidean(6), lambda q, u: (q[0] @ MOTIONS.hat(q[1]), u - 0.3 * q[1] * jnp.roll(q[1], 1)), half_square, 6
)
PLANE = Euclidean(2)
HELD = OptimalControlProblem(
    PLANE,
    lambda q, u: jnp.stack([q[1], u[0]]),
    half_square,
    1,
    control_bounds=(-6.0, 6.0),
    constraints={"speed": lambda q, u: q[1] - 1.35},
)
POSE = np.block([[SLEW_END, np.array([[1.0], [2.0], [3.0]])], [np.zeros((1, 3)), np.ones((1, 1))]])
CASES = {
    "slew": (SLEW, Midpoint(Cayley(RIGID)), (IDENTITY, REST), (SLEW_END, REST), 60.0, 20),
    "slew to any rate, uneven steps": (
        SLEW,
        Midpoint(Cayley(RIGID)),
        (IDENTITY, REST),
        (SLEW_END, None),
        60.0,
        [1.0, 2.0] * 5,
    ),
    "slew by collocation": (SLEW, Gauss(2, default_retraction(RIGID)), (IDENTITY, REST), (SLEW_END, REST), 60.0, 6),
    "pendulum": (SPUN, Midpoint(default_retraction(SPUN.manifold)), (-TARGET, REST), (np.eye(3)[0], REST), 2.0, 20),
    "within limits": (HELD, Gauss(2, default_retraction(PLANE)), np.zeros(2), np.array([1.0, 0.0]), 1.0, 10),
    "free end": (LANDED, Midpoint(default_retraction(SPHERE)), np.eye(3)[0], None, 1.0, 10),
    "docking": (
        DOCKED,
        Midpoint(default_retraction(DOCKED.manifold)),
        (np.eye(4), np.zeros(6)),
        (POSE, np.zeros(6)),
        2.0,
        10,
    ),
}


@pytest.mark.parametrize("name", CASES)
@pytest.mark.usual(1)
def test_ipopt_finds_the_solution(name):
    problem, method, start, end, horizon, steps = CASES[name]
    discrete = to_casadi(problem, method, start, end, horizon, steps)
    solution = solve(problem, start, end, horizon, method=method, steps=steps)
    solver = ca.nlpsol("solver", "ipopt", discrete.nlp, QUIET)
    found = solver(**discrete.arguments)
    assert solver.stats()["success"]
    np.testing.assert_allclose(float(found["f"]), solution.cost, rtol=1e-9)
    guess = discrete.guess(found)
    pairs = zip(
        (guess.states, guess.controls, guess.costates),
        (solution.stage_states, solution.controls, solution.costates),
        strict=True,
    )
    for a, b in ((a, b) for pair in pairs for a, b in zip(*map(jax.tree.leaves, pair), strict=True)):
        np.testing.assert_allclose(a, b, rtol=0, atol=1e-6 * max(1.0, np.max(np.abs(b))))


@pytest.mark.parametrize(
    "manifold",
    [
        SO(3),
        SE(2),
        SE(3),
        U(2),
        SU(2),
        SU(3),
        SPHERE,
        Hyperbolic(2),
        Simplex(2),
        Stiefel(4, 2),
        ComplexStiefel(3, 2),
        Oblique(3, 2),
        SPD(3),
        Ellipsoid(),
    ],
    ids=str,
)
@pytest.mark.usual(2)
def test_equations_are_as_many_as_the_codimension_and_independent(manifold):
    x = jax.jit(manifold.random_point)(jax.random.key(3))
    units = np.eye(x.size).reshape(x.size, *x.shape)
    units = np.concatenate([units, 1j * units]) if jnp.iscomplexobj(x) else units

    @jax.jit
    def linearised(x, units):
        values, push = jax.linearize(lambda a: equations(manifold, a), x)
        return values, jax.vmap(push, out_axes=1)(units)

    values, slopes = linearised(x, units)
    assert slopes.shape == (len(units) - manifold.dimension, len(units))
    assert np.linalg.matrix_rank(slopes) == len(slopes)
    np.testing.assert_allclose(values, 0, atol=1e-12)


def test_what_cannot_be_written_is_said():
    rank = FixedRank(3, 3, 1)
    problem = OptimalControlProblem(rank, lambda q, u: rank.projection(q, u.reshape(3, 3)), half_square, 9)
    x = np.diag([1.0, 0.0, 0.0])
    with pytest.raises(InvalidInputError, match="no independent equations"):
        to_casadi(problem, Midpoint(default_retraction(rank)), x, 2 * x, 1.0, 4)
    with pytest.raises(InvalidInputError, match="horizon must be"):
        to_casadi(*CASES["free end"][:4], -1.0, 10)
    with pytest.raises(InvalidInputError, match=r"horizon must be .* try that of a solution, solution.horizon"):
        to_casadi(*CASES["free end"][:4], Free(1.0), 10)
    with pytest.raises(NotOnManifoldError, match="start"):
        to_casadi(LANDED, CASES["free end"][1], 2 * np.eye(3)[0], None, 1.0, 10)
