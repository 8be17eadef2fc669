"""Free horizons, free parameters and explicit time, against closed forms and against the problem with what was
found."""

from dataclasses import replace
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from retrax.integrators import Free, Guess, OptimalControlProblem, Solution, Solver, load_solution, solve
from retrax.integrators.boundary_value.inputs.arguments import BoundaryData
from retrax.integrators.boundary_value.reformulations.reformulation import Reformulation
from retrax.manifolds import SO, Euclidean, InvalidInputError, NotOnManifoldError, hat
from retrax.retractions import Addition, Adjoint, Cayley, Euler, Gauss, Midpoint, ProductRetraction, Theta

from .problems import rotation

PLANE, LINE = Euclidean(2), Euclidean(1)
REST, AHEAD = np.zeros(2), np.array([1.0, 0.0])
GAUSS = Gauss(2, Addition(PLANE))
BODY = SO(3) * Euclidean(3)
INERTIA = np.array([3.0, 2.0, 1.0])


def cart(q, u):
    return jnp.stack([q[1], u[0]])


def timed_effort(q, u):
    return 1 + u @ u / 2


QUICK = OptimalControlProblem(PLANE, cart, timed_effort, 1)
T_BEST = 18**0.25  # of T + 6 / T^3


@cache
def quickly():
    return Solver(QUICK, GAUSS, 6)


def assert_same_extremal(found, other, tolerance=1e-9):
    for name in (
        "times",
        "stage_times",
        "states",
        "costates",
        "stage_states",
        "stage_costates",
        "controls",
        "hamiltonians",
    ):
        pairs = zip(jax.tree.leaves(getattr(found, name)), jax.tree.leaves(getattr(other, name)), strict=True)
        for a, b in pairs:
            np.testing.assert_allclose(a, b, atol=tolerance * (1 + np.max(np.abs(b))), err_msg=name)
    assert found.cost == pytest.approx(other.cost, rel=tolerance)


def test_a_free_horizon_is_found_from_far_above_and_below():
    """``int 1 + u^2 / 2`` from rest to rest over the distance 1: ``T + 6 / T^3``; two points a step integrate it
    exactly."""
    solver = quickly()
    for guess in (0.02 * T_BEST, 0.3 * T_BEST, T_BEST, 5 * T_BEST, 100 * T_BEST):
        found = solver.solve(REST, AHEAD, Free(guess))
        assert found.horizon == pytest.approx(T_BEST, rel=1e-11)
        assert found.cost == pytest.approx(T_BEST + 6 / T_BEST**3, rel=1e-12)
        assert np.max(np.abs(found.hamiltonians)) < 1e-11
        assert found.checks.hamiltonian_spread < 1e-11
        assert found.checks.strict_minimum
    assert_same_extremal(found, solver.solve(REST, AHEAD, found.horizon))


@pytest.mark.parametrize("unit", [1e-6, 1.0, 1e6])
def test_a_free_horizon_does_not_depend_on_the_unit_of_time(unit):
    """``x'' = u`` in other units of time: ``int 1 + unit^3 u^2 / 2``, so that ``T`` grows with the unit."""
    scaled = OptimalControlProblem(PLANE, cart, lambda q, u: 1 / unit + unit**3 * u @ u / 2, 1)
    found = solve(scaled, REST, AHEAD, Free(3 * unit), method=GAUSS, steps=6)
    assert found.horizon == pytest.approx(unit * T_BEST, rel=1e-10)


@pytest.mark.usual("3")
@pytest.mark.parametrize("stages", [2, 3, 4])
def test_a_free_horizon_does_not_depend_on_the_unit_of_length(stages):
    """A lander from the solution over a horizon that is too long: whatever it is written in, the horizon rests in the
    steps."""
    space, start = Euclidean(4), np.array([400.0, 1000.0, 20.0, -40.0])
    method, found = Gauss(stages, Addition(space)), []
    for decade in range(-3, 4):
        unit = 10.0**decade

        def land(q, u, unit=unit):
            return jnp.concatenate([q[2:], unit * (u - np.array([0.0, 1.62]))])

        lander = OptimalControlProblem(space, land, lambda q, u: jnp.sqrt(u @ u + 0.01) + 0.01 * (u @ u), 2)
        first = solve(lander, unit * start, np.zeros(4), 40.0, method=method, steps=20)
        found.append(solve(lander, unit * start, np.zeros(4), Free(40.0), method=method, steps=20, guess=first))
    assert {each.statistics.iterations for each in found} == {found[0].statistics.iterations}
    assert [each.horizon for each in found] == pytest.approx([31.1158] * len(found), rel=1e-4)


def turning(q, u, inertia):
    R, w = q
    return R @ hat(w), (u - jnp.cross(w, inertia * w)) / inertia


START, END = (np.eye(3), np.zeros(3)), (rotation([0.4, 0.9, -0.5]), np.zeros(3))
METHODS = {
    "Gauss": Gauss(2, Cayley(BODY)),
    "one point": Gauss(1, Cayley(BODY)),
    "midpoint": Midpoint(Cayley(BODY)),
    "Euler": Euler(Cayley(BODY)),
    "adjoint": Adjoint(Theta(Cayley(BODY), 0.3, Cayley(BODY))),
    "product": Midpoint(ProductRetraction(Cayley(SO(3)), Addition(Euclidean(3)))),
}


@pytest.mark.parametrize("name", METHODS)
@pytest.mark.usual(1)
def test_the_record_is_that_of_the_problem_with_the_horizon_that_was_found(name):
    """By every method the steps are those of the problem itself, so that only the horizon is new."""
    slew = OptimalControlProblem(BODY, turning, lambda q, u: 1 + u @ u / 2, 3)
    solver = Solver(slew, METHODS[name], 6)
    found = solver.solve(START, END, Free(2.0), parameters=INERTIA)
    again = solver.solve(START, END, found.horizon, parameters=INERTIA)
    assert_same_extremal(found, again, 1e-7)
    for field in ("momenta", "body_costates", "spatial_costates"):
        assert list(getattr(found, field)) == list(getattr(again, field))
    assert list(found.checks.violations) == list(again.checks.violations)
    assert found.checks.conserved == again.checks.conserved
    assert abs(np.mean(found.hamiltonians)) < 1e-8 * found.checks.hamiltonian_size
    np.testing.assert_array_equal(found.parameters, INERTIA)


def test_what_is_kept_is_traced_once():
    slew = OptimalControlProblem(BODY, turning, lambda q, u: 1 + u @ u / 2, 3)
    solver = Solver(slew, METHODS["midpoint"], 4)
    solver.solve(START, END, Free(2.0), parameters=INERTIA)
    ((_, inner),) = solver._reformulation._made.values()
    first = dict(inner._transcription._found)
    for scale in (0.9, 1.1):
        solver.solve(START, END, Free(2.5 * scale), parameters=scale * INERTIA)
    assert dict(inner._transcription._found) == first
    assert len(solver._reformulation._made) == 1


def drift(q, u, given):
    return u + given["gain"] * given["drift"]


DRIFTING = OptimalControlProblem(LINE, drift, lambda q, u, given: u @ u / 2 + given["drift"] @ given["drift"] / 2, 1)


@pytest.mark.parametrize("gain", [0.1, 1.0, 10.0])
def test_a_parameter_is_optimised(gain):
    """``x' = u + g a`` from 0 to 1 over T at ``int (u^2 + a^2) / 2``: ``u = a / g = 1 / (T (1 + g^2))``."""
    solver = Solver(DRIFTING, Midpoint(Addition(LINE)), 4)
    found = solver.solve(np.zeros(1), np.ones(1), 2.0, parameters={"gain": gain, "drift": Free(np.array([0.3]))})
    best = gain / (2 * (1 + gain**2))
    assert found.parameters["drift"] == pytest.approx(best, rel=1e-11)
    np.testing.assert_allclose(found.controls, best / gain, rtol=1e-11)
    assert found.parameters["gain"] == gain
    assert_same_extremal(found, solver.solve(np.zeros(1), np.ones(1), 2.0, parameters=found.parameters))


def test_a_parameter_and_the_horizon_are_optimised_together():
    """With ``int 1 + (u^2 + a^2) / 2``, ``1 + 1 / (2 T^2 (1 + g^2))`` times T is least at ``T^2 = 1 / (2 (1 +
    g^2))``."""
    cost = lambda q, u, given: 1 + u @ u / 2 + given["drift"] @ given["drift"] / 2  # noqa: E731
    both = OptimalControlProblem(LINE, drift, cost, 1)
    given = {"gain": 2.0, "drift": Free(np.zeros(1))}
    found = solve(both, np.zeros(1), np.ones(1), Free(1.0), method=Midpoint(Addition(LINE)), steps=4, parameters=given)
    assert found.horizon == pytest.approx(0.1**0.5, rel=1e-11)
    assert found.parameters["drift"] == pytest.approx(0.4 / found.horizon, rel=1e-11)


MOVING = OptimalControlProblem(LINE, lambda q, u, t: u + jnp.sin(t), lambda q, u, t: u @ u / 2, 1, time_dependent=True)


@pytest.mark.parametrize("horizon", [0.5, 2.0, 6.0])
def test_the_time_in_the_functions(horizon):
    """``x' = u + sin t`` from 0 to 1: ``u`` is constant, ``(1 - (1 - cos T)) / T``; and ``H = p x' - u^2 / 2`` with ``p
    = u``."""
    found = solve(MOVING, np.zeros(1), np.ones(1), horizon, method=Gauss(4, Addition(LINE)), steps=8)
    best = np.cos(horizon) / horizon
    np.testing.assert_allclose(found.controls, best, rtol=1e-9)
    np.testing.assert_allclose(found.hamiltonians, best * (best / 2 + np.sin(found.stage_times)), atol=1e-9)
    assert found.checks.hamiltonian_spread < 1e-4 * np.ptp(found.hamiltonians)
    assert found.horizon == pytest.approx(horizon, rel=1e-15)


def test_the_time_of_a_free_horizon_ends_with_it():
    """``x' = u``, ``int u^2 / 2`` with the terminal cost ``t / 2``: ``1 / (2 T) + T / 2`` is least at 1."""
    late = OptimalControlProblem(
        LINE, lambda q, u, t: u, lambda q, u, t: u @ u / 2, 1, terminal_cost=lambda q, t: t / 2, time_dependent=True
    )
    found = solve(late, np.zeros(1), np.ones(1), Free(3.0), method=Midpoint(Addition(LINE)), steps=5)
    assert found.horizon == pytest.approx(1.0, rel=1e-11)
    np.testing.assert_allclose(found.hamiltonians, 0.5, rtol=1e-10)  # d Phi / dt at the end


def test_a_guess_and_a_solution_are_taken():
    places = (np.repeat(np.arange(6), 2) + np.tile(GAUSS.nodes, 6)) / 6
    guess = Guess(np.stack([places, np.ones(12)], axis=1), np.zeros((12, 1)))
    solver = quickly()
    found = solver.solve(REST, AHEAD, Free(1.0), guess=guess)
    assert found.horizon == pytest.approx(T_BEST, rel=1e-11)
    again = solver.solve(REST, AHEAD, Free(found.horizon), guess=found)
    assert again.statistics.iterations <= 1
    moving = solve(MOVING, np.zeros(1), np.ones(1), 1.0, method=Midpoint(Addition(LINE)), steps=5)
    again = solve(MOVING, np.zeros(1), np.ones(1), 1.0, method=Midpoint(Addition(LINE)), steps=5, guess=moving)
    assert again.statistics.iterations <= 1


def test_a_batch_is_solved_at_once():
    solver, ends = quickly(), np.array([[0.5, 0.0], [1.0, 0.0], [3.0, 0.0]])
    many = solver.solve_many(REST, ends, Free(np.array([1.0, 2.0, 3.0])))
    for k, found in enumerate(many):
        assert found.horizon == pytest.approx((18 * ends[k, 0] ** 2) ** 0.25, rel=1e-10)
    several = Solver(DRIFTING, Midpoint(Addition(LINE)), 4)
    given = {"gain": np.array([0.5, 2.0]), "drift": Free(np.zeros((2, 1)))}
    for gain, found in zip(
        given["gain"], several.solve_many(np.zeros(1), np.ones(1), 2.0, parameters=given), strict=True
    ):
        assert found.parameters["drift"] == pytest.approx(gain / (2 * (1 + gain**2)), rel=1e-10)
    timed = Solver(MOVING, Gauss(4, Addition(LINE)), 8)
    for horizon, found in zip((1.0, 2.0), timed.solve_many(np.zeros(1), np.ones(1), np.array([1.0, 2.0])), strict=True):
        np.testing.assert_allclose(found.controls, np.cos(horizon) / horizon, rtol=1e-9)


def test_derivatives_of_what_was_found():
    """``T^4 = 18 L^2``, so that the cost ``4 T / 3`` has the derivative ``2 T / (3 L)`` by the distance, minus the
    costate."""
    solver = quickly()
    found = solver.solve(REST, AHEAD, Free(1.0))
    by = solver.sensitivity(found)
    assert by.horizon is None
    assert by.parameters is None
    np.testing.assert_allclose(by.start.cost, -found.costates[0], atol=1e-9)
    assert by.end.cost[0] == pytest.approx(2 * T_BEST / 3, rel=1e-9)
    several = Solver(DRIFTING, Midpoint(Addition(LINE)), 4)
    best = several.solve(np.zeros(1), np.ones(1), 2.0, parameters={"gain": 2.0, "drift": Free(np.zeros(1))})
    by = several.sensitivity(best)
    assert by.parameters["drift"] is None
    assert by.parameters["gain"].cost == pytest.approx(-2.0 / 50, rel=1e-9)  # of 1 / (4 (1 + g^2))
    assert by.horizon.cost == pytest.approx(-1 / 40, rel=1e-9)


def test_a_record_with_parameters_is_read_again(tmp_path):
    given = {"gain": 2.0, "drift": Free(np.zeros(1))}
    found = solve(DRIFTING, np.zeros(1), np.ones(1), 2.0, method=Midpoint(Addition(LINE)), steps=4, parameters=given)
    found.save(tmp_path / "found.npz")
    read = load_solution(tmp_path / "found.npz")
    assert read.horizon == found.horizon
    assert read.parameters["gain"] == 2.0
    np.testing.assert_array_equal(read.parameters["drift"], found.parameters["drift"])


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((None,), "Free: guess must be a real number or an array of them, got None"),
        (("10",), "Free: guess must be a real number or an array of them, got '10'"),
        ((True,), "Free: guess must be a real number or an array of them, got True"),
        ((1j,), "Free: guess must be a real number or an array of them, got 1j"),
        ((np.nan,), "Free: guess must be a real number or an array of them, got nan"),
        ((np.inf,), "Free: guess must be finite, got inf"),
        (([[1.0], [1.0, 2.0]],), "Free: guess must be a number or an array"),
        (
            ((np.eye(3), np.zeros(3)),),
            r"(?s)got \(array.*; .* try a Free for each part, \(Free\(q\[0\]\), Free\(q\[1\]\)\)$",
        ),
        ((1.0, np.nan), "Free: lower must be a real number or an array of them, got nan"),
        ((1.0, 2.0, 0.0), "Free: lower must be less than upper, got 2.0 and 0.0"),
        ((1.0, 1.0, 1.0), "Free: lower must be less than upper, got 1.0 and 1.0"),
        ((3.0, 1.0, 2.0), "Free: guess must lie between lower and upper, got 3.0, 1.0, 2.0"),
        ((np.ones(2), np.zeros(3)), r"Free: lower has shape \(3,\), expected that of the guess, \(2,\), or a number"),
    ],
)
def test_what_is_not_free_is_named(arguments, words):
    with pytest.raises(InvalidInputError, match=words):
        Free(*arguments)


def test_free_is_frozen():
    given = Free(1.0, lower=0.5)
    with pytest.raises(AttributeError, match="Free is frozen"):
        given.guess = 2.0
    assert repr(given) == "Free(1.0, lower=0.5, upper=inf)"
    with pytest.raises(InvalidInputError, match="Free: guess is traced by JAX"):
        jax.jit(lambda a: Free(a).guess)(1.0)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"horizon": Free(-1.0)}, r"horizon must be free around a positive finite time, got Free\(-1.0"),
        ({"horizon": Free(np.ones(2))}, r"horizon must be free around a positive finite time, got Free\(array"),
        (
            {"horizon": Free(2.0), "parameters": {"gain": 1.0}},
            r"parameters are given, .* no function of the problem takes them",
        ),
        ({"horizon": Free(2.0), "guess": 3}, r"guess must be a Guess or a Solution, got 3"),
        (
            {"horizon": Free(2.0), "guess": Guess(np.zeros((5, 2)), np.zeros(5))},
            r"guess: states must have shapes \(12, 2\), got",
        ),
        ({"horizon": Free(2.0), "steps": 0}, r"steps must be a whole number"),
        ({"horizon": Free(2.0), "tolerance": -1.0}, r"tolerance must be a positive"),
        ({"horizon": Free(2.0), "end": np.zeros(3)}, r"end: .*shape \(2,\), got \(3,\)"),
    ],
)
def test_arguments_beside_a_free_horizon_are_checked(change, words):
    given = {"start": REST, "end": AHEAD, "steps": 6, **change}
    with pytest.raises((InvalidInputError, NotOnManifoldError), match=words):
        solve(QUICK, method=GAUSS, **given)


@pytest.mark.parametrize("cost", [lambda q, u: 1.0, lambda q, u: 1 + q[1] ** 2, lambda q, u: 1 + u[0]])
def test_a_free_horizon_without_a_cost_of_every_control_is_refused(cost):
    with pytest.raises(InvalidInputError, match=r"the problem is singular, .* minimum time, and needs control_bounds"):
        solve(
            OptimalControlProblem(PLANE, cart, cost, 1),
            REST,
            AHEAD,
            Free(2.0),
            method=Midpoint(Addition(PLANE)),
            steps=6,
        )


def test_constraints_have_parameters_and_time():
    """``x' = u``, ``int u^2 / 2`` with ``u <= a t``, from 0 to 1 over 2: ``u = min(a t, c)``."""
    bounded = OptimalControlProblem(
        LINE,
        lambda q, u, t: u,
        lambda q, u, t: u @ u / 2,
        1,
        constraints={"ramp": lambda q, u, t, given: u - given * t},
        time_dependent=True,
    )
    solver = Solver(bounded, Midpoint(Addition(LINE)), 40)
    for slope in (2.0, 4.0, 40.0):
        found = solver.solve(np.zeros(1), np.ones(1), 2.0, parameters=slope)
        level = slope * (2 - np.sqrt(4 - 2 / slope))  # of c (2 - c / a) + c^2 / (2 a) = 1
        np.testing.assert_allclose(found.controls[:, 0], np.minimum(slope * found.stage_times, level), atol=2e-3)
        assert list(found.multipliers) == ["ramp"]


class OtherUnit(Reformulation[BoundaryData, BoundaryData, Solution, Solution]):
    """The cart with states in another unit of length."""

    def __init__(self, unit):
        self.unit, self.problem = unit, OptimalControlProblem(PLANE, self.moved, timed_effort, 1)

    def moved(self, y, u):
        return cart(self.unit * y, u) / self.unit

    def apply(self, data):
        return data._replace(start=data.start / self.unit, end=data.end / self.unit)

    def guess(self, data, posed):
        return None

    def recover(self, posed, found):
        states = {name: self.unit * getattr(found, name) for name in ("states", "stage_states")}
        costates = {name: getattr(found, name) / self.unit for name in ("costates", "stage_costates")}
        return replace(found, **states, **costates)


@pytest.mark.parametrize("unit", [1e-3, 1.0, 1e3])
def test_a_reformulation_of_ones_own_is_one_class(unit):
    own = OtherUnit(unit)
    solver = Solver(own.problem, GAUSS, 6)
    given = BoundaryData(REST, AHEAD, Free(1.0), None)
    found = own.solve(given, lambda posed, guess: solver.solve(**posed._asdict(), guess=guess))
    assert_same_extremal(found, quickly().solve(REST, AHEAD, Free(1.0)))
    with pytest.raises(InvalidInputError, match="OtherUnit recovers no derivatives"):
        own.recover_sensitivity(None)


def test_functions_of_time_that_fail_are_named():
    wrong = OptimalControlProblem(LINE, lambda q, u, t: u + t[0], lambda q, u, t: u @ u, 1, time_dependent=True)
    with pytest.raises(InvalidInputError, match=r"functions fail at a point q of R\^1.*dynamics, line "):
        solve(wrong, np.zeros(1), np.ones(1), 1.0, method=Midpoint(Addition(LINE)), steps=3)
