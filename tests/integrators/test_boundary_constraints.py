"""Ends on sets, coupled and periodic ends: transversality and multipliers against closed forms."""

import re

import jax.numpy as jnp
import numpy as np
import pytest
from retrax.integrators import Free, OptimalControlProblem, Phase, Solver, load_solution, solve, solve_phases
from retrax.manifolds import SO, Euclidean, InvalidInputError, Sphere, hat
from retrax.retractions import Addition, Cayley, Gauss, Midpoint, default_retraction

PLANE, LINE = Euclidean(2), Euclidean(1)
GLOBE, TURN = Sphere(2), SO(3)


def direct(q, u):
    return u


def effort(q, u, *_):
    return u @ u / 2


def leaning(a, b, place):
    return b @ b - place**2


def test_an_end_on_a_circle_from_inside_to_outside():
    """The radial line: cost ``(r - 1)^2 / (2 T)``, ``p(T) = -mu d|q|^2``; at ``r = 1`` nothing moves, and ``mu =
    0``."""
    problem = OptimalControlProblem(PLANE, direct, effort, 2, boundary_constraints={"circle": leaning})
    solver, start = Solver(problem, Midpoint(Addition(PLANE)), 4), np.array([0.6, 0.8])
    for radius in (0.3, 0.9, 1 - 1e-6, 1.0, 1 + 1e-6, 1.1, 3.0):
        found = solver.solve(start, Free(radius * np.array([0.8, 0.6])), 2.0, parameters=radius)
        assert found.success
        assert found.checks.strict_minimum
        assert found.cost == pytest.approx((radius - 1) ** 2 / 4, abs=1e-12)
        np.testing.assert_allclose(found.states[-1], radius * start, atol=1e-10)
        np.testing.assert_allclose(found.multipliers["circle"], (1 - radius) / (4 * radius), atol=1e-10)
        np.testing.assert_allclose(found.costates[-1], -2 * found.multipliers["circle"] * found.states[-1], atol=1e-10)


@pytest.mark.parametrize(
    ("length", "time"),
    [(1e-9, 1e-3), (1e-9, 1e4), (1e-3, 1e3), (1.0, 1e-3), (1.0, 1.0), (1.0, 1e4), (1e5, 1.0), (1e5, 1e4)],
)
@pytest.mark.usual(2)
def test_nothing_but_an_equation_says_how_far_it_is(length, time):
    """From rest to a place at any speed, ``x(T) = X``, with ``u^2 / 2``: ``3 X^2 / (2 T^3)``; with a free horizon and
    ``1 + u^2 / 2`` in units of the problem ``T^4 = 9 / 2`` and ``4 T / 3``."""
    problem = OptimalControlProblem(
        PLANE,
        lambda q, u, c: jnp.stack([q[1], u[0]]),
        lambda q, u, c: c[1] + c[2] * u @ u / 2,
        1,
        boundary_constraints={"place": lambda a, b, c: b[0] - c[0]},
    )
    solver, given = Solver(problem, Gauss(2, Addition(PLANE)), 15), np.array([length, 1 / time, time**3 / length**2])
    for horizon, cost in ((time, 1 + 1.5), (2 * time, 2 + 1.5 / 8), (Free(2 * time), 4 / 3 * 4.5**0.25)):
        found = solver.solve(np.zeros(2), None, horizon, parameters=given)
        assert found.success
        assert found.checks.strict_minimum
        assert found.cost == pytest.approx(cost, rel=1e-12)
    assert found.horizon == pytest.approx(4.5**0.25 * time, rel=1e-9)


@pytest.mark.parametrize("size", [1.0, 1e3, 1e9])
@pytest.mark.parametrize("shift", [0.0, 1e-15, 1e-8, 1.0])
@pytest.mark.usual(2)
def test_an_optimum_at_rest_is_found_from_everywhere(size, shift):
    """A periodic motion that costs nothing: what its trajectory moves by is rounding, and no unit."""
    problem = OptimalControlProblem(
        PLANE,
        lambda q, u, c: jnp.stack([q[1], u[0]]),
        lambda q, u, c: u @ u / 2 + (q[0] - c) ** 2,
        1,
        boundary_constraints={"loop": lambda a, b, c: b - a},
    )
    places = np.linspace(0.1, 3.0, 30)
    rests = np.stack([places, 0 * places], axis=1)
    solver = Solver(problem, Gauss(2, Addition(PLANE)), 10)
    found = solver.solve_many(Free(size * rests), Free(size * rests * (1 + shift)), 1.0, parameters=places)
    assert found.success.all()
    np.testing.assert_allclose(found.states, np.broadcast_to(rests[:, None], found.states.shape), atol=1e-7)


def test_both_ends_on_sets():
    """From the unit circle to the line ``x + y = c``: along its normal, with one covector ``p``, by both
    multipliers."""
    between = {"circle": lambda a, b, c: a @ a - 1, "line": lambda a, b, c: b[0] + b[1] - c}
    problem = OptimalControlProblem(PLANE, direct, effort, 2, boundary_constraints=between)
    solver = Solver(problem, Midpoint(Addition(PLANE)), 3)
    for c in (2.0, 4.0):
        found = solver.solve(Free(np.array([0.9, 0.2])), Free(np.array([2.0, 1.0])), 1.0, parameters=c)
        p = (c / np.sqrt(2) - 1) / np.sqrt(2)
        np.testing.assert_allclose(found.costates, np.full((4, 2), p), rtol=1e-9)
        assert found.multipliers["circle"] == pytest.approx(p / np.sqrt(2), rel=1e-9)
        assert found.multipliers["line"] == pytest.approx(-p, rel=1e-9)
        assert found.checks.strict_minimum


@pytest.mark.slow
def test_an_end_on_a_circle_of_latitude():
    """The meridian to the latitude ``z = h``: cost ``angle^2 / 2``, and ``mu = angle / sin``, over the equator and at
    it."""
    problem = OptimalControlProblem(
        GLOBE, lambda q, u, h: jnp.cross(u, q), effort, 3, boundary_constraints={"latitude": lambda a, b, h: b[2] - h}
    )
    solver = Solver(problem, Gauss(2, default_retraction(GLOBE)), 6)
    start = np.array([np.sin(0.7), 0.0, np.cos(0.7)])
    for polar in (0.3, 1.2, np.pi / 2, 2.0):
        aside = np.array([np.sin(polar) * np.cos(0.3), np.sin(polar) * np.sin(0.3), np.cos(polar)])
        found = solver.solve(start, Free(aside), 1.0, parameters=np.cos(polar))
        assert found.cost == pytest.approx((polar - 0.7) ** 2 / 2, rel=1e-8)
        assert found.multipliers["latitude"] == pytest.approx((polar - 0.7) / np.sin(polar), rel=1e-7)
        assert abs(found.costates[-1] @ np.cross([0, 0, 1], found.states[-1])) < 1e-10  # along the set
        assert found.checks.strict_minimum


@pytest.mark.slow
def test_an_axis_of_an_attitude_is_pointed():
    """``R e_3`` to a direction by the shortest rotation; what turns about it is free, and so are both ends of a copy of
    it."""
    aim = np.array([np.sin(1.1), 0.0, np.cos(1.1)])
    pointed = {"boresight": lambda a, b: (b.T @ aim)[:2]}
    problem = OptimalControlProblem(TURN, lambda q, u: q @ hat(u), effort, 3, boundary_constraints=pointed)
    found = solve(problem, np.eye(3), Free(np.array(np.eye(3))), 1.0, method=Gauss(2, Cayley(TURN)), steps=6)
    assert found.cost == pytest.approx(1.1**2 / 2, rel=1e-6)
    np.testing.assert_allclose(found.states[-1] @ [0, 0, 1], aim, atol=1e-11)
    body = next(iter(found.body_costates.values()))
    assert abs(body[-1, 2]) < 1e-10


def test_a_periodic_optimum_under_a_periodic_force():
    """``x' = u - x``, ``int u^2 / 2 + 5 (x - cos 2 pi t)^2``: ``x = 10 cos(2 pi t) / (11 + 4 pi^2)``, and ``p = u = x'
    + x``."""
    forced = OptimalControlProblem(
        LINE,
        lambda q, u, t: u - q,
        lambda q, u, t: u @ u / 2 + 5 * (q[0] - jnp.cos(2 * jnp.pi * t)) ** 2,
        1,
        periodic=True,
        time_dependent=True,
    )
    found = solve(forced, Free(np.zeros(1)), None, 1.0, method=Gauss(3, Addition(LINE)), steps=12)
    size, phase = 10 / (11 + 4 * np.pi**2), 2 * np.pi * found.times
    np.testing.assert_allclose(found.states[:, 0], size * np.cos(phase), atol=1e-8)
    np.testing.assert_allclose(found.costates[:, 0], size * (np.cos(phase) - 2 * np.pi * np.sin(phase)), atol=1e-7)
    assert found.costates[0] == pytest.approx(found.costates[-1], rel=1e-10)
    assert "q(T) = q(0)" in repr(forced)


@pytest.mark.slow
def test_periodic_up_to_a_rotation():
    """``R(T) = g R(0)``: a turn at constant rate, the spatial costate is constant and commutes with g; the start
    costs."""
    angle = 0.8
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1.0]])

    def turned(q):
        return turn @ q

    problem = OptimalControlProblem(
        TURN, lambda q, u: q @ hat(u), effort, 3, initial_cost=lambda q: -jnp.trace(q), periodic=turned
    )
    aside = np.array([[0.8, -0.6, 0], [0.6, 0.8, 0], [0, 0, 1.0]])
    found = solve(problem, Free(aside), Free(turn @ aside), 1.0, method=Gauss(2, Cayley(TURN)), steps=6)
    assert found.cost == pytest.approx(angle**2 / 2 - 3, rel=1e-7)
    np.testing.assert_allclose(found.states[0], np.eye(3), atol=1e-9)
    np.testing.assert_allclose(found.states[-1], turn @ found.states[0], atol=1e-11)
    (spatial,) = found.spatial_costates.values()
    np.testing.assert_allclose(spatial, np.tile([0, 0, angle], (7, 1)), atol=1e-6)
    assert found.checks.strict_minimum
    assert "q(T) = turned(q(0))" in repr(problem)


@pytest.mark.slow
def test_least_time_to_a_line():
    """A cart with ``|u| <= 1`` from rest to ``x = L``, its velocity free: ``T = sqrt(2 L)``, ``dT/dL = 1 / sqrt(2
    L)``."""
    cart = OptimalControlProblem(
        PLANE,
        lambda q, u, place: jnp.stack([q[1], u[0]]),
        lambda q, u, place: 1.0,
        1,
        control_bounds=(-1, 1),
        boundary_constraints={"line": lambda a, b, place: b[0] - place},
    )
    solver = Solver(cart, Gauss(2, Addition(PLANE)), 5)
    for place in (0.1, 1.0, 30.0):
        found = solver.solve(np.zeros(2), Free(np.array([place, 0.1])), Free(1.0), parameters=place)
        assert found.horizon == pytest.approx(np.sqrt(2 * place), rel=1e-8)
        assert found.multipliers["line"] == pytest.approx(-1 / np.sqrt(2 * place), rel=1e-6)


def test_equations_from_independent_to_dependent():
    """``x = 1`` and ``x + share (y - 1) = 1``: one point, as long as the second says more than the first."""
    both = {"both": lambda a, b, share: jnp.stack([b[0] - 1, b[0] + share * (b[1] - 1) - 1])}
    problem = OptimalControlProblem(PLANE, direct, effort, 2, boundary_constraints=both)
    solver, end = Solver(problem, Midpoint(Addition(PLANE)), 3), Free(np.array([0.9, 0.7]))
    for share in (1.0, 1e-3, 1e-6):
        found = solver.solve(np.zeros(2), end, 1.0, parameters=share)
        np.testing.assert_allclose(found.states[-1], [1, 1], atol=1e-10 / share)
        assert found.multipliers["both"][1] == pytest.approx(-1 / share, rel=1e-8)
    for share in (1e-10, 0.0):
        with pytest.raises(
            InvalidInputError, match=r"2 equations, of which 1 is independent.*\['both'\]\[1\] depends on"
        ):
            solver.solve(np.zeros(2), end, 1.0, parameters=share)


@pytest.mark.parametrize(
    ("between", "words"),
    [
        ({"start": lambda a, b: a[0] - 1}, r"1 equation, of which 0 are independent"),
        ({"three": lambda a, b, c, d: b}, r"boundary_constraints\['three'\] must be a function of \(q_0, q_T\)"),
        ({"text": lambda a, b: "no"}, r"boundary_constraints\['text'\] must return a real number or a vector"),
        (
            {"truth": lambda a, b: a[0] == b[0]},
            r"boundary_constraints\['truth'\] must .* bool values; return a number that is zero where .*, as a - b",
        ),
        (
            {"table": lambda a, b: jnp.outer(a, b)},
            r"boundary_constraints\['table'\] must return a number or a vector, got an array",
        ),
        ({"": leaning}, r"got the name ''"),
        ([leaning], r"boundary_constraints must be a dictionary of functions by their names"),
    ],
)
@pytest.mark.usual(2)
def test_what_are_no_boundary_constraints_is_named(between, words):
    start, end = np.array([1.0, 0, 0]), Free(np.array([0.0, 1.0, 0]))

    def solved():
        problem = OptimalControlProblem(GLOBE, lambda q, u: jnp.cross(u, q), effort, 3, boundary_constraints=between)
        return solve(problem, start, end, 1.0, method=Midpoint(default_retraction(GLOBE)), steps=3)

    with pytest.raises(InvalidInputError, match=words):
        solved()


@pytest.mark.parametrize("name", ["periodic", "control_bounds lower", "horizon upper", "cone"])
def test_names_of_other_multipliers_are_refused(name):
    words = rf"boundary_constraints\['{name}'\] has a name under which .* try '{name} of the ends'"
    with pytest.raises(InvalidInputError, match=words):
        OptimalControlProblem(
            GLOBE,
            lambda q, u: jnp.cross(u, q),
            effort,
            3,
            constraints={"cone": lambda q, u: q[0] - 2},
            boundary_constraints={name: leaning},
        )


def test_equations_that_depend_on_each_other_where_they_hold():
    """``q(T) - q(0)`` on a sphere: three equations, of which two are independent where the ends are one point."""
    force = jnp.array([0.0, 0.0, 1.0])
    problem = OptimalControlProblem(
        GLOBE,
        lambda q, u: jnp.cross(u, q),
        lambda q, u: u @ u / 2 - q @ force,
        3,
        boundary_constraints={"same": lambda a, b: b - a},
    )
    places = np.array([0.2, 0.1, 1.0]) / np.linalg.norm([0.2, 0.1, 1.0])
    method, words = Midpoint(default_retraction(GLOBE)), r"depend on each other, .*\[2\]; try .* periodic=True"
    for most in (9, 30):
        solution = solve(
            problem, Free(places), Free(places), 1.0, method=method, steps=3, max_iterations=most, throw=False
        )
        assert re.search(words, solution.result)
        assert not solution.checks.strict_minimum


def test_an_optimum_whose_equations_depend_on_each_other_is_not_shown_to_be_one():
    """``x = 1`` and ``(x - 1)(1 + y) = 0``, alone and in phases: the optimum is found, and its matrix is singular."""

    def twice(q):
        return jnp.stack([q[0] - 1, (q[0] - 1) * (1 + q[1])])

    method, start, end = Midpoint(Addition(PLANE)), np.zeros(2), Free(np.array([0.8, 0.3]))
    free = OptimalControlProblem(PLANE, direct, effort, 2)
    whole = free._with_arguments(boundary_constraints={"twice": lambda a, b: twice(b)})
    found = solve(whole, start, end, 1.0, method=method, steps=3)
    assert found.cost == pytest.approx(0.5)
    assert "depend on each other" in found.result
    assert not found.checks.strict_minimum
    halves = [Phase(free, method, 3, 0.5, start=start), Phase(free, method, 3, 0.5, end=end)]
    both = solve_phases(halves, boundary_constraints={"twice": lambda phases: twice(phases[1].end)})
    assert both.cost == pytest.approx(0.5)
    assert "depend on each other" in both.result
    assert not both.strict_minimum


def test_periodic_ends_that_are_prescribed_are_named():
    problem = OptimalControlProblem(PLANE, direct, effort, 2, periodic=True)
    with pytest.raises(InvalidInputError, match=r"2 equations, of which 0 are .* free: periodic depends on"):
        solve(problem, np.zeros(2), np.ones(2), 1.0, method=Midpoint(Addition(PLANE)), steps=3)


@pytest.mark.slow
def test_what_is_not_periodic_is_named():
    with pytest.raises(InvalidInputError, match=r"periodic must be True, .* or a function g .*, got 'yes'"):
        OptimalControlProblem(PLANE, direct, effort, 2, periodic="yes")
    wrong = OptimalControlProblem(PLANE, direct, effort, 2, periodic=lambda q: q[:1])
    with pytest.raises(InvalidInputError, match=r"the value of periodic, a point"):
        solve(wrong, Free(np.ones(2)), None, 1.0, method=Midpoint(Addition(PLANE)), steps=3)
    fine = OptimalControlProblem(PLANE, direct, effort, 2, boundary_constraints={"nan": lambda a, b: jnp.nan * b[0]})
    solution = solve(fine, np.zeros(2), Free(np.ones(2)), 1.0, method=Midpoint(Addition(PLANE)), steps=3, throw=False)
    assert "NaN or infinity at the guess" in solution.result


def test_batches_files_and_what_does_not_treat_coupled_ends(tmp_path):
    problem = OptimalControlProblem(PLANE, direct, effort, 2, boundary_constraints={"circle": leaning})
    solver = Solver(problem, Midpoint(Addition(PLANE)), 4)
    radii = np.array([0.5, 2.0, 3.0])
    many = solver.solve_many(np.array([0.6, 0.8]), Free(np.array([1.0, 0.0])), 1.0, parameters=radii)
    assert many.success.all()
    np.testing.assert_allclose(many.cost, (radii - 1) ** 2 / 2, rtol=1e-9)
    many[1].save(tmp_path / "found.npz")
    read = load_solution(tmp_path / "found.npz")
    np.testing.assert_array_equal(read.multipliers["circle"], many[1].multipliers["circle"])
    assert "circle: multipliers" in str(read)
    again = solver.solve(np.array([0.6, 0.8]), None, 1.0, guess=many[1], parameters=2.0)
    assert again.statistics.iterations <= 1
    with pytest.raises(InvalidInputError, match="boundary constraints, which sensitivity does not treat"):
        solver.sensitivity(again)
