"""Bounds of controls, constraints, an initial cost and an explicit time: what a problem is told, and what it
refuses."""

from types import MappingProxyType

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from retrax.integrators import OptimalControlProblem, PresymplecticIntegrator, classify, integrate
from retrax.integrators.boundary_value.inputs.boundary_data import EndPart, PrescribedEnd
from retrax.integrators.boundary_value.transcription.inequality_rows import InequalityRows
from retrax.integrators.dirac import DiracSystem
from retrax.integrators.problem.optimal_control_problem import is_same_problem
from retrax.integrators.problem_checks.requirements import require_treated, require_values
from retrax.manifolds import SO, Euclidean, InvalidInputError, Sphere, hat
from retrax.retractions import Addition, CotangentLift, Midpoint
from retrax.tape import Tape

PLANE = Euclidean(2)
BODY = SO(3) * Euclidean(3)
STATE, CONTROL = (np.eye(3), np.array([0.5, 0.25, -2.0])), np.array([1.0, -3.0, 0.5])
MIDPOINT = Midpoint(Addition(PLANE))


def turning(q, u):
    return q[0] @ hat(q[1]), u


def effort(q, u):
    return u @ u / 2


def body(controls=3, **options):
    return OptimalControlProblem(BODY, turning, effort, controls, **options)


def cart(**options):
    return OptimalControlProblem(PLANE, lambda q, u: jnp.stack([q[1], u[0]]), effort, 1, **options)


LIMITED = body(
    control_bounds=([-1.0, -np.inf, -2.0], [3.0, 4.0, 5.0]),
    constraints={"rate": lambda q, u: q[1] @ q[1] - 1, "cone": lambda q, u: [q[0][0, 0], u[1]], "any": lambda q, u: 0},
)
NAMES = (
    *("control_bounds lower[0]", "control_bounds lower[2]"),
    *(f"control_bounds upper[{i}]" for i in range(3)),
    *("rate", "cone[0]", "cone[1]", "any"),
)
VALUES = [-2.0, -2.5, -2.0, -7.0, -4.5, 0.0625 + 0.25 + 4 - 1, 1.0, -3.0, 0.0]


def test_inequalities_are_the_finite_bounds_then_the_constraints_in_order():
    assert LIMITED._inequality_names == NAMES
    np.testing.assert_array_equal(LIMITED.inequalities(STATE, CONTROL), VALUES)
    np.testing.assert_array_equal(jax.jit(LIMITED.inequalities)(STATE, CONTROL), VALUES)
    tape = Tape.trace(lambda w, u: LIMITED.inequalities((jnp.eye(3), w), u), STATE[1], CONTROL)
    np.testing.assert_allclose(tape(STATE[1][:, None], CONTROL[:, None])[:, 0], VALUES, rtol=1e-15)
    lower, upper = LIMITED.control_bounds
    np.testing.assert_array_equal([lower, upper], [[-1, -np.inf, -2], [3, 4, 5]])
    assert list(LIMITED.constraints) == ["rate", "cone", "any"]


def test_numbers_of_the_inequalities_come_back_under_their_names():
    found = LIMITED._limits.by_name(np.arange(18.0).reshape(2, 9), LIMITED._inequality_sizes)
    assert list(found) == ["control_bounds lower", "control_bounds upper", "rate", "cone", "any"]
    np.testing.assert_array_equal(found["control_bounds lower"], [[0, 0, 1], [9, 0, 10]])
    np.testing.assert_array_equal(found["cone"], [[6, 7], [15, 16]])
    assert found["any"].shape == (2, 1)
    free = (PrescribedEnd.of((EndPart("", False, 1, 3, 3),), (False,)),) * 2
    mask = InequalityRows(LIMITED, None, 3).mask(4, free)
    assert mask.shape == (4, 3, 9)
    assert np.all(mask)


def test_a_problem_without_inequalities_has_none():
    for given in (
        body(),
        body(control_bounds=(-np.inf, np.inf)),
        body(constraints={}),
        body(control_bounds=None, constraints=None),
    ):
        assert given._inequality_names == ()
        assert given.inequalities(STATE, CONTROL).shape == (0,)
        assert not given._limits.any
        require_treated(given, "nothing")
    turn = OptimalControlProblem(SO(3), lambda q, u: q @ hat(u), lambda q, u: u @ u, Sphere(2))
    assert turn.inequalities(np.eye(3), np.eye(3)[0]).shape == (0,)


def test_controls_of_any_shape_have_bounds():
    grid = OptimalControlProblem(
        PLANE, lambda q, u: u @ q, lambda q, u: jnp.sum(u**2), Euclidean((2, 2)), control_bounds=(-1, 4)
    )
    assert grid._inequality_names[1] == "control_bounds lower[0, 1]"
    np.testing.assert_array_equal(grid.inequalities(np.ones(2), np.arange(4.0).reshape(2, 2))[4:], [-4, -3, -2, -1])
    assert grid.control_bounds[0].shape == (2, 2)


def test_parameters_and_time_reach_every_function():
    """Each function is a number of its arguments, so that an order that is wrong shows."""
    line = Euclidean(1)
    moving = OptimalControlProblem(
        line,
        lambda q, u, t, a: q + 10 * u + 100 * t + 1000 * a,
        lambda q, u, t: q[0] - t,
        1,
        terminal_cost=lambda q, t, a: q[0] + 2 * t + 3 * a,
        initial_cost=lambda q, a: q[0] - a,
        control_bounds=(-1, 1),
        constraints={"late": lambda q, u, t, a: t - a},
        time_dependent=True,
    )
    assert moving.takes_parameters
    now = moving.with_parameters(4.0).at_time(3.0)
    assert not now.takes_parameters
    assert not now.time_dependent
    q, u = np.ones(1), np.full(1, 2.0)
    assert now.velocity(q, u)[0] == 1 + 20 + 300 + 4000
    assert (now.cost_rate(q, u), now.final_cost(q), now.first_cost(q)) == (-2.0, 19.0, -3.0)
    np.testing.assert_array_equal(now.inequalities(q, u), [-3, 1, -1])


def test_constraints_belong_to_what_makes_two_problems_equal():
    def at_most(a):
        return cart(constraints={"speed": lambda q, u: q[1] - a})

    assert is_same_problem(at_most(1.0), at_most(1.0))
    assert not is_same_problem(at_most(1.0), at_most(2.0))
    assert not is_same_problem(cart(control_bounds=(-1, 1)), cart(control_bounds=(-1, 2)))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"control_bounds": 1.0}, r"control_bounds must be a pair \(lower, upper\) of numbers or arrays, got 1.0; try"),
        ({"control_bounds": (-1.0,)}, r"control_bounds must be a pair .*got \(-1.0,\)"),
        ({"control_bounds": (1.0, -1.0)}, r"control_bounds of u\[0\] are 1 and -1, expected the lower one first"),
        ({"control_bounds": (-1, [1, 1, -2])}, r"control_bounds of u\[2\] are -1 and -2, expected the lower one first"),
        ({"control_bounds": (0, [1, 0, 1])}, r"control_bounds of u\[1\] are both 0, .*into the dynamics"),
        ({"control_bounds": (np.inf, np.inf)}, r"control_bounds of u\[0\] are inf and inf"),
        ({"control_bounds": (-np.inf, -np.inf)}, r"control_bounds of u\[0\] are -inf and -inf"),
        (
            {"control_bounds": (np.nan, 1)},
            r"control_bounds: lower has entries that are NaN, expected .* where there is no bound",
        ),
        (
            {"control_bounds": (-1, [1, 1])},
            r"control_bounds: upper has shape \(2,\), expected a number or an array of shape \(3,\)",
        ),
        (
            {"control_bounds": (-1, [[1], [1, 2]])},
            r"control_bounds: upper is \[\[1\], \[1, 2\]\], expected a number or an array",
        ),
        ({"control_bounds": (None, 1)}, r"control_bounds: lower is None, expected .*-numpy.inf"),
        ({"control_bounds": (1j, 1)}, r"control_bounds: lower is 1j, expected"),
        ({"control_bounds": ("low", "high")}, r"control_bounds: lower is 'low', expected"),
        (
            {"control_bounds": (-1, 1), "controls": Sphere(2)},
            r"control_bounds are given.*controls in R\^m; try constraints=",
        ),
        (
            {"constraints": lambda q, u: 0},
            r"constraints must be a dictionary of functions by their names, got <function",
        ),
        ({"constraints": [effort]}, r"constraints must be a dictionary"),
        ({"constraints": {1: effort}}, r"constraints must have names that are words, got 1"),
        ({"constraints": {" ": effort}}, r"constraints must have names that are words, got ' '"),
        ({"constraints": {"control_bounds lower": effort}}, r"which bounds have; try another"),
        ({"constraints": {"cone": 1.0}}, r"constraints\['cone'\] must be a function of a state and a control, got 1.0"),
        (
            {"constraints": {"cone": lambda q: 0}},
            r"constraints\['cone'\] must be a function of \(q, u\).*arguments \(q\)$",
        ),
        (
            {"constraints": {"cone": lambda q, u, t: 0}},
            r"constraints\['cone'\] must be .*arguments \(q, u, t\)",
        ),
        ({"initial_cost": 1.0}, r"initial_cost must be a function of q, got 1.0"),
        ({"initial_cost": lambda q, u, p: 0}, r"initial_cost must be a function of q, or of these and parameters"),
        ({"time_dependent": 1}, r"time_dependent must be True or False, got 1"),
        (
            {"time_dependent": True},
            r"dynamics must be a function of \(q, u, t\), or of these and parameters.*arguments \(q, u\)$",
        ),
    ],
)
def test_what_is_no_bound_no_constraint_and_no_cost_is_named(options, words):
    with pytest.raises(InvalidInputError, match=rf"(?s){words}"):
        body(**options)


@pytest.mark.parametrize("names", ["t, q, u", "q, t, u", "q, time, u, a", "t, q, u, a"])
def test_the_time_comes_after_the_control(names):
    given = eval(f"lambda {names}: None")
    with pytest.raises(InvalidInputError, match=rf"dynamics must be a function of \(q, u, t\).*arguments \({names}\)"):
        OptimalControlProblem(PLANE, given, lambda q, u, t: 0, 1, time_dependent=True)


def test_other_mappings_are_taken_and_bounds_that_are_traced_are_not():
    assert body(constraints=MappingProxyType({"cone": effort}))._inequality_names == ("cone",)
    with pytest.raises(InvalidInputError, match=r"control_bounds: upper is traced by JAX, .*try constraints="):
        jax.jit(lambda a: body(control_bounds=(-1.0, a)).inequalities(STATE, CONTROL))(1.0)


@pytest.mark.parametrize(
    ("constraint", "words"),
    [
        (
            lambda q, u: None,
            r"constraints\['cone'\] must return a real number or a vector of them, got nothing; did it forget",
        ),
        (lambda q, u: "no", r"must return a real number or a vector of them, got 'no'"),
        (
            lambda q, u: u[0] < 1,
            r"must return a real number or a vector of them, got bool values; return a number that is not positive "
            r"where the control is admissible, as u\[0\] - 1 for u\[0\] < 1",
        ),
        (lambda q, u: 1j * u, r"must return a real number or a vector of them, got a complex one"),
        (
            lambda q, u: jnp.outer(u, u),
            r"must return a number or a vector, got an array of shape \(3, 3\); jnp.ravel it",
        ),
        (lambda q, u: u[0] * q["x"], r"functions fail at a point q of .*constraints\['cone'\], line "),
        (
            lambda q, u: jnp.log(-(u[0] ** 2)),
            r"constraints\['cone'\] is not finite at q = .* u = .*u @ u - a\*\*2 in place",
        ),
        (lambda q, u: jnp.sqrt(u @ u) - 1, r"constraints\['cone'\] has no finite derivative by the controls at q = "),
    ],
)
def test_a_constraint_that_returns_something_else_is_named(constraint, words):
    with pytest.raises(InvalidInputError, match=rf"(?s){words}"):
        body(constraints={"cone": constraint}).check(STATE, np.zeros(3))


def test_an_initial_cost_that_is_no_number_is_named():
    with pytest.raises(InvalidInputError, match=r"initial_cost must return a scalar, got an array of shape \(3,\)"):
        require_values(body(initial_cost=lambda q: q[1]))


LEFT_OUT = {
    "control bounds": {"control_bounds": (-1, 1)},
    "constraints": {"constraints": {"speed": lambda q, u: q[1] - 1}},
}


@pytest.mark.parametrize("name", LEFT_OUT)
def test_what_treats_no_inequalities_says_so(name):
    given, words = (
        cart(**LEFT_OUT[name]),
        rf"the problem has {name}, which .* does not treat; expected a problem without",
    )
    begin = np.zeros(2), np.zeros(2)
    for call in (
        lambda: classify(given),
        lambda: integrate(given, PresymplecticIntegrator(CotangentLift(MIDPOINT)), begin, 0.1, 2),
        lambda: DiracSystem.controlled(given, lambda q: jnp.ones((1, 2))),
    ):
        with pytest.raises(InvalidInputError, match=words):
            call()


def test_a_problem_prints_in_mathematical_notation():
    assert repr(LIMITED).splitlines() == [
        "OptimalControlProblem:",
        "minimise    int_0^T effort(q, u) dt",
        "subject to  q' = turning(q, u),  q in SO(3) x R^3,  u in R^3",
        "            -1 <= u[0] <= 3, u[1] <= 4, -2 <= u[2] <= 5",
        "            rate(q, u) <= 0",
        "            cone(q, u) <= 0",
        "            any(q, u) <= 0",
    ]
    paid = cart(control_bounds=(-1, 1), initial_cost=lambda q: q[0], terminal_cost=lambda q, given: q[1] * given)
    assert str(paid).splitlines()[1:] == [
        "minimise    (lambda)(q(0), p) + int_0^T effort(q, u, p) dt + (lambda)(q(T), p)",
        "subject to  q' = (lambda)(q, u, p),  q in R^2,  u in R^1",
        "            -1 <= u <= 1",
    ]


def test_functions_of_the_time_print_with_it():
    """Between the ends it is the time of the last one."""

    def drift(q, u, t):
        return u + t

    problem = OptimalControlProblem(
        Euclidean(1),
        drift,
        lambda q, u, t: u @ u,
        1,
        terminal_cost=lambda q, t: q[0] * t,
        boundary_constraints={"tide": lambda start, end, t: end - jnp.sin(t) - start},
        time_dependent=True,
    )
    assert str(problem).splitlines()[1:] == [
        "minimise    int_0^T (lambda)(q, u, t) dt + (lambda)(q(T), T)",
        "subject to  q' = drift(q, u, t),  q in R^1,  u in R^1",
        "            tide(q(0), q(T), T) = 0",
    ]
