"""Derivatives of an extremal by its ends, horizon and parameters, against differences of solutions."""

import gc
import weakref
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from retrax.integrators import OptimalControlProblem, Solver
from retrax.manifolds import SE, ConvergenceError, Euclidean, InvalidInputError, Product, Sphere, hat
from retrax.manifolds.numerics import ambient as vec
from retrax.retractions import Exponential, Gauss, Midpoint, Projection, Radau, Theta, default_retraction

from tests.support.changing import held

from .problems import INERTIA, REST, RIGID, rotation

PLANE, SPHERE, LINE, POSES = Euclidean(2), Sphere(2), Euclidean(1), SE(2)
SWINGING = Product(SPHERE, Euclidean(3))
NAMES = "cost", "states", "costates", "controls"
DIFFERENCE = 1e-5
MASS = {"mass": 1.3, "rates": np.array([0.3, 0.1])}


def cart(q, u, p):
    """A mass with linear and cubic drag."""
    return jnp.stack([q[1], (u[0] - p["rates"][0] * q[1] - p["rates"][1] * q[1] ** 3) / p["mass"]])


def turned(q, u, p):
    """A point of the sphere, turned by a control and by a wind."""
    return jnp.cross(p["mass"] * u + jnp.array([0, p["rates"][1], 0.4]), q)


def body(q, u, p):
    """Rigid body with three torques."""
    return q[0] @ hat(q[1]), (u - jnp.cross(q[1], INERTIA * q[1])) / INERTIA / p["mass"]


def boat(q, u, p):
    """A heading on the sphere in a current."""
    return p["mass"] * u + p["rates"][0] * jnp.stack([q[1], -q[0], 0.3 * q[0] * q[2]])


def effort(q, u):
    return u @ u / 2


def pulled(q, u, p):
    return u @ u / 2 + 0.3 * q[2] ** 2 + p["rates"][0] * q[0]


class Subject(NamedTuple):
    """A problem with a method and ends."""

    problem: OptimalControlProblem
    method: Any
    steps: Any
    start: Any
    end: Any


def quartic(q, p):
    return p["mass"] * jnp.sum((q - 1) ** 4 + (q - 1) ** 2)


UNEQUAL = np.array([1, 2, 1, 1, 3])
TURN = (np.eye(3), REST), (rotation([0.5, 0.3, -0.8]), REST)
CART = OptimalControlProblem(PLANE, cart, effort, 1)
CAUGHT = OptimalControlProblem(PLANE, cart, effort, 1, terminal_cost=quartic)
ON_SPHERE = OptimalControlProblem(SPHERE, turned, pulled, 3, terminal_cost=lambda q: q[0] ** 3 / 2 + q[1] * q[2] / 2)
SLEW = OptimalControlProblem(RIGID, body, effort, 3, terminal_cost=lambda q: 0.3 * q[1] @ q[1] + jnp.sum(q[0] ** 3))
BOAT = OptimalControlProblem(Euclidean(3), boat, lambda q, u: 1 + q @ q / 2 + 0.2 * u[1:] @ u[1:], Sphere(2))
SUBJECTS = {
    "cart": Subject(CART, Midpoint(Exponential(PLANE)), UNEQUAL, np.zeros(2), np.array([1.0, 0.0])),
    "caught cart": Subject(CAUGHT, Gauss(2, Exponential(PLANE)), UNEQUAL, np.zeros(2), None),
    "theta": Subject(CAUGHT, Theta(Exponential(PLANE), 0.3), 4, np.zeros(2), np.array([1.0, 0.0])),
    "sphere": Subject(ON_SPHERE, Midpoint(Projection(SPHERE)), 4, np.array([1.0, 0, 0]), np.array([0.6, 0, 0.8])),
    "sphere by Gauss": Subject(
        ON_SPHERE, Gauss(2, Projection(SPHERE)), 3, np.array([1.0, 0, 0]), np.array([0.6, 0, 0.8])
    ),
    "slew": Subject(SLEW, Midpoint(default_retraction(RIGID)), 4, *TURN),
    "slew by Gauss": Subject(SLEW, Gauss(2, default_retraction(RIGID)), UNEQUAL[:3], TURN[0], (TURN[1][0], None)),
    "boat": Subject(BOAT, Midpoint(Exponential(Euclidean(3))), 4, np.zeros(3), np.array([0.33, 0.99, -0.22])),
}
OFTEN = "cart", "caught cart", "theta", "sphere by Gauss", "slew"


def moved(manifold, point, k, size):
    """A point moved along the basis vector number ``k``, with None where it is free."""
    known = jax.tree.map(lambda s: jnp.zeros(s.shape), manifold.ambient) if point is None else point
    known = (
        tuple(jnp.zeros(3) if part is None else jnp.asarray(part) for part in known)
        if isinstance(known, tuple)
        else known
    )
    direction = jax.tree.map(lambda leaf: size * leaf[k], manifold.basis(known))
    found = default_retraction(manifold)(known, direction)
    if isinstance(point, tuple):
        return tuple(None if given is None else np.asarray(leaf) for given, leaf in zip(point, found, strict=True))
    return np.asarray(found)


def assert_derivative(found, place, solutions, what, tolerance=1e-8):
    """The derivative at a place of its leading axes is the difference of two solutions."""
    plus, minus = solutions
    for name in NAMES:
        own = getattr(found, name)
        for one, a, b in zip(
            *(jax.tree.leaves(t) for t in (own, getattr(plus, name), getattr(minus, name))), strict=True
        ):
            expected = (a - b) / (2 * DIFFERENCE)
            limit = tolerance * (1 + np.max(np.abs(expected)))
            np.testing.assert_allclose(one[place], expected, rtol=0, atol=limit, err_msg=f"{name} by {what}")


@pytest.mark.parametrize("name", [n if n in OFTEN else pytest.param(n, marks=pytest.mark.slow) for n in SUBJECTS])
@pytest.mark.usual(1)
def test_derivatives_are_those_of_differences(name):
    problem, method, steps, start, end = SUBJECTS[name]
    manifold, solver = problem.manifold, Solver(problem, method, steps)
    solution = solver.solve(start, end, 1.1, parameters=MASS)
    found = solver.sensitivity(solution)

    def pair(make):
        ends = (make(size) for size in (DIFFERENCE, -DIFFERENCE))
        near = solution if name == "boat" else None  # at a given speed there are several ways
        return [solver.solve(*given, near, parameters) for *given, parameters in ends]

    for k in range(manifold.dimension):
        both = pair(lambda e, k=k: (moved(manifold, start, k, e), end, 1.1, MASS))
        assert_derivative(found.start, k, both, f"start, {k}")
        if end is not None and not (isinstance(end, tuple) and end[1] is None and k >= 3):
            both = pair(lambda e, k=k: (start, moved(manifold, end, k, e), 1.1, MASS))
            assert_derivative(found.end, k, both, f"end, {k}")
        else:
            assert all(np.all(leaf[k] == 0) for leaf in jax.tree.leaves([getattr(found.end, part) for part in NAMES]))
    assert_derivative(found.horizon, (), pair(lambda e: (start, end, 1.1 + e, MASS)), "horizon")
    assert_derivative(
        found.parameters["mass"], (), pair(lambda e: (start, end, 1.1, {**MASS, "mass": 1.3 + e})), "mass"
    )
    for k in range(2):
        rate = MASS["rates"] * 0 + np.eye(2)[k]
        both = pair(lambda e, rate=rate: (start, end, 1.1, {**MASS, "rates": MASS["rates"] + e * rate}))
        assert_derivative(found.parameters["rates"], k, both, f"rates, {k}")


def rolling(q, u, p):
    """A unicycle that slips sideways where it turns."""
    return q @ POSES.hat(jnp.stack([u[1], u[0], p["slip"] * u[1]]))


def swinging(q, u, p):
    """A spherical pendulum with a drag and three torques."""
    return jnp.cross(q[1], q[0]), jnp.cross(q[0], jnp.array([0, 0, -p["gravity"]])) + u - 0.2 * q[1]


UNICYCLE = OptimalControlProblem(
    POSES,
    rolling,
    lambda q, u, p: u[0] ** 2 / 2 + 0.3 * u[1] ** 2 + 0.1 * q[0, 2] ** 2,
    2,
    control_bounds=(np.array([-0.95, -0.6]), np.array([0.95, 0.6])),
)
PENDULUM = OptimalControlProblem(
    SWINGING,
    swinging,
    effort,
    3,
    terminal_cost=lambda q, p: 3 * p["gravity"] * jnp.sum((q[0] - jnp.array([0.6, 0, 0.8])) ** 2) + q[1] @ q[1],
    control_bounds=(-3.0, 3.0),
    node_constraints={"reach": lambda q, p: q[0][0] - 0.42 * p["gravity"]},
)
PARKED = np.array([[np.cos(0.4), -np.sin(0.4), 0.9], [np.sin(0.4), np.cos(0.4), 0.35], [0, 0, 1]])
SWUNG = np.array([0.0, 0.6, -0.8]), np.array([-0.3, 0.1, 0.0])
LIMITED = {
    "unicycle": (UNICYCLE, Midpoint(default_retraction(POSES)), np.eye(3), PARKED, {"slip": 0.15}),
    "unicycle by Gauss": (UNICYCLE, Gauss(3, default_retraction(POSES)), np.eye(3), PARKED, {"slip": 0.15}),
    "pendulum by Radau": (PENDULUM, Radau(2, default_retraction(SWINGING)), SWUNG, None, {"gravity": 1.0}),
}


@pytest.mark.parametrize("name", [pytest.param("unicycle", marks=pytest.mark.slow), *list(LIMITED)[1:]])
@pytest.mark.usual(1)
def test_derivatives_along_active_limits_are_those_of_differences(name):
    problem, method, start, end, parameters = LIMITED[name]
    solver, (key,) = Solver(problem, method, 8), parameters
    solution = solver.solve(start, end, 1.2, parameters=parameters, tolerance=1e-12)
    assert np.max(solution.multipliers["control_bounds upper"]) > 0.1
    found = solver.sensitivity(solution)

    def pair(make):
        ends = (make(size) for size in (DIFFERENCE, -DIFFERENCE))
        return [solver.solve(*given, solution, value, 1e-12) for *given, value in ends]

    for k in (0, problem.manifold.dimension - 1):
        both = pair(lambda e, k=k: (moved(problem.manifold, start, k, e), end, 1.2, parameters))
        assert_derivative(found.start, k, both, f"start, {k}")
    assert_derivative(found.horizon, (), pair(lambda e: (start, end, 1.2 + e, parameters)), "horizon")
    value = parameters[key]
    assert_derivative(found.parameters[key], (), pair(lambda e: (start, end, 1.2, {key: value + e})), key)


@pytest.fixture(scope="module")
def oscillator():
    """The action of a unit oscillator by the midpoint rule, and its conjugate horizon."""
    problem = OptimalControlProblem(LINE, lambda q, u: u, lambda q, u: (u @ u - q @ q) / 2, 1)
    return Solver(problem, Midpoint(Exponential(LINE)), 10), 20 * np.tan(np.pi / 20)


@pytest.mark.parametrize("offset", [s * 10.0**-k for k in (1, 3, 5, 7, 9) for s in (1, -1)])
@pytest.mark.usual(3)
def test_derivatives_grow_towards_a_conjugate_point(oscillator, offset):
    """They are ``sin t / sin T`` by the end, in the angles of the midpoint rule; none are given with less than six
    digits."""
    solver, conjugate = oscillator
    solution = solver.solve(np.zeros(1), np.zeros(1), conjugate * (1 + offset), throw=False)
    if abs(offset) < 1e-8:
        with pytest.raises((ConvergenceError, InvalidInputError), match=r"one of a family|with success"):
            solver.sensitivity(solution)
        return
    angle = 2 * np.arctan(conjugate * (1 + offset) / 20)
    expected = np.sin(angle * np.arange(11)) / np.sin(10 * angle)
    found = solver.sensitivity(solution).end.states[0, :, 0]
    np.testing.assert_allclose(found, expected, rtol=2e-12 / abs(offset), atol=1e-9)


def test_a_family_of_extremals_has_no_derivatives(oscillator):
    solver, conjugate = oscillator
    solution = solver.solve(np.zeros(1), np.zeros(1), conjugate, throw=False)
    error = ConvergenceError if solution.success else InvalidInputError
    with pytest.raises(error, match="one of a family" if solution.success else "with success"):
        solver.sensitivity(solution)


@pytest.mark.parametrize("price", [1e-12, 1e-6, 0.0])
def test_a_function_without_a_derivative_by_the_parameters_is_blamed_itself(price):
    """The price of the control is the square root of a number: its derivative grows, until there is none."""
    problem = OptimalControlProblem(LINE, lambda q, u, p: u, lambda q, u, p: (1 + jnp.sqrt(p)) * (u @ u) / 2, 1)
    solver = Solver(problem, Midpoint(Exponential(LINE)), 4)
    found = solver.solve(np.zeros(1), np.ones(1), 1.0, parameters=price)
    if price:
        derivative = solver.sensitivity(found).parameters.cost
        assert derivative == pytest.approx(0.25 / np.sqrt(price), rel=1e-9)
    else:
        with pytest.raises(ConvergenceError, match="no finite derivative by its parameters along this extremal"):
            solver.sensitivity(found)


def test_a_member_of_a_batch_has_the_derivatives_of_the_trajectory_alone():
    problem, method, steps, start, end = SUBJECTS["caught cart"]
    solver = Solver(problem, method, steps)
    horizons = np.array([0.7, 1.1, 1.9])
    given = jax.tree.map(lambda leaf: np.stack([leaf, 1.1 * leaf, 0.8 * leaf]), jax.tree.map(np.asarray, MASS))
    many = solver.solve_many(start, end, horizons, parameters=given)
    for k in range(3):
        alone = solver.solve(start, end, horizons[k], parameters=jax.tree.map(lambda leaf, k=k: leaf[k], given))
        one, other = (jax.tree.leaves(vars_of(solver.sensitivity(s))) for s in (many[k], alone))
        for a, b in zip(one, other, strict=True):
            np.testing.assert_allclose(a, b, rtol=0, atol=1e-10 * (1 + np.max(np.abs(b))))


def vars_of(found):
    """All numbers of a record."""
    parts = found.start, found.end, found.horizon, *found.parameters.values()
    return [[getattr(part, name) for name in NAMES] for part in parts]


def test_the_cost_falls_by_the_costate_at_the_start_and_by_the_hamiltonian_in_time():
    """Pontryagin's costates: ``dJ/dq_0 = -p_0``, ``dJ/dq_N = p_N``; ``dJ/dT`` is minus the mean of the discrete
    energies."""
    problem, method, steps, start, end = SUBJECTS["cart"]
    solver = Solver(problem, method, steps)
    solution = solver.solve(start, end, 1.1, parameters=MASS)
    found = solver.sensitivity(solution)
    np.testing.assert_allclose(found.start.cost, -solution.costates[0], rtol=1e-12)
    np.testing.assert_allclose(found.end.cost, solution.costates[-1], rtol=1e-12)
    assert found.horizon.cost == pytest.approx(-solution.hamiltonians @ UNEQUAL / np.sum(UNEQUAL), rel=1e-10)


def test_it_is_printed_by_its_shapes(oscillator):
    solver, _ = oscillator
    found = solver.sensitivity(solver.solve(np.zeros(1), np.ones(1), 1.0))
    shapes = "states=f64[1,11,1], costates=f64[1,11,1], controls=f64[1,10,1]"
    assert repr(found).startswith(f"Sensitivity(start=Derivative(cost=f64[1], {shapes}), end=Derivative(cost=f64[1], ")
    assert "horizon=Derivative(cost=f64[], states=f64[11,1]" in repr(found)


def test_another_solver_s_solution_and_one_without_success_are_refused(oscillator):
    solver, conjugate = oscillator
    other = Solver(solver.problem, solver.method, 10)
    solution = other.solve(np.zeros(1), np.ones(1), 1.0)
    missed = solver.solve(np.zeros(1), np.ones(1), conjugate, throw=False)
    for wrong in (solution, missed, None):
        with pytest.raises(
            InvalidInputError, match="a solution with success of a regular problem that this solver found"
        ):
            solver.sensitivity(wrong)


def test_a_solution_that_is_forgotten_leaves_the_solver(oscillator):
    solver, _ = oscillator
    solution = solver.solve(np.zeros(1), np.ones(1), 1.0)
    seen = weakref.ref(solution)
    del solution
    gc.collect()
    assert seen() is None


@pytest.mark.parametrize("change", [0.0, 1e-6, 1e-2, 1.0])
@pytest.mark.parametrize("stages", [1, 2])
@pytest.mark.usual(2)
def test_derivatives_of_functions_that_have_changed_are_refused(change, stages):
    """The solver's own functions stay as they were; those for derivatives are traced where they are asked for first."""
    product, set_to = held("slots", 1.0)
    problem = OptimalControlProblem(LINE, lambda q, u: u - 0.1 * q**2, lambda q, u: u @ product(u) / 2, 1)
    solver = Solver(problem, Gauss(stages, Exponential(LINE)), 2)
    solution = solver.solve(np.zeros(1), np.ones(1), 1.0)
    set_to(1.0 + change)
    if change:
        with pytest.raises(InvalidInputError, match="compute other values than when the solver was made"):
            solver.sensitivity(solution)
    else:
        assert np.all(np.isfinite(solver.sensitivity(solution).horizon.states))


def test_costates_stay_covectors():
    """``p`` is tangent at ``q``, so that ``<dp, q> = -<p, dq>`` on the sphere."""
    problem, method, steps, start, end = SUBJECTS["sphere"]
    solver = Solver(problem, method, steps)
    solution = solver.solve(start, end, 1.1, parameters=MASS)
    found = solver.sensitivity(solution).end
    for dq, dp in zip(found.states, found.costates, strict=True):
        np.testing.assert_allclose(np.sum(dq * solution.states, axis=1), 0, atol=1e-13)
        np.testing.assert_allclose(np.sum(dp * solution.states + solution.costates * dq, axis=1), 0, atol=1e-12)
    assert vec.size(found.costates) > 0.1
