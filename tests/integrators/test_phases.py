"""Phases that follow one another: bang-bang arcs, staging, interfaces and cycles, against closed forms."""

import jax.numpy as jnp
import numpy as np
import pytest
from retrax.integrators import Free, Guess, OptimalControlProblem, Phase, solve, solve_phases
from retrax.integrators.boundary_value.drivers.phase_guess import guess_phases
from retrax.manifolds import SO, ConvergenceError, Euclidean, InvalidInputError, Sphere, hat
from retrax.retractions import Addition, Cayley, Gauss, Midpoint, default_retraction
from scipy.optimize import minimize_scalar

PLANE, LINE, GLOBE = Euclidean(2), Euclidean(1), Sphere(2)
GAUSS, ALONG = Gauss(2, Addition(PLANE)), Gauss(3, Addition(LINE))
REST = np.zeros(2)


def arc(q, u, force):
    return jnp.stack([q[1], force + 0 * q[0]])


FORCED = OptimalControlProblem(PLANE, arc, lambda q, u, force: 1.0, 0)


def bang_bang(length, guesses):
    first = Phase(FORCED, GAUSS, 2, Free(guesses[0]), start=REST, parameters=1.0)
    return [first, Phase(FORCED, GAUSS, 2, Free(guesses[1]), end=np.array([length, 0.0]), parameters=-1.0)]


def test_bang_bang_arcs_of_a_double_integrator():
    """From rest to rest over L with ``|u| = 1``: both arcs take ``sqrt(L)``, ``H = 0``, and ``dT/dL = 1 / sqrt(L) =
    p_x``."""
    for length, guesses in ((1.0, (0.3, 4.0)), (100.0, (3.0, 3.0))):
        seen = []
        found = solve_phases(bang_bang(length, guesses), callback=lambda one, seen=seen: seen.append(one.cost[0]))
        assert seen[-1] == pytest.approx(found.cost, rel=1e-10)
        np.testing.assert_allclose(found.durations, np.sqrt(length), rtol=1e-10)
        assert found.cost == pytest.approx(2 * np.sqrt(length), rel=1e-10)
        assert found.strict_minimum
        for phase in found.phases:
            np.testing.assert_allclose(phase.hamiltonians, 0.0, atol=1e-9)
            np.testing.assert_allclose(phase.costates[:, 0], 1 / np.sqrt(length), rtol=1e-9)
        np.testing.assert_allclose(found.phases[0].costates[-1, 1], 0.0, atol=1e-9)  # the switching function
        assert found.phases[1].times[0] == found.phases[0].times[-1]
        np.testing.assert_allclose(found(1.5 * np.sqrt(length)).states[1], 0.5 * np.sqrt(length), rtol=1e-9)
    again = solve_phases(bang_bang(100.0, (1.0, 1.0)), guess=found)
    assert again.phases[0].statistics.iterations <= 1
    assert "phase 1" in str(again)


def test_a_phase_without_a_guess_begins_where_the_guess_of_the_one_before_ends():
    along = OptimalControlProblem(LINE, lambda q, u: u, lambda q, u: u @ u / 2, 1)
    known = Guess(np.array([[0.5], [2.0]]), np.ones((2, 1)))
    first = Phase(along, Midpoint(Addition(LINE)), 2, 1.0, start=np.zeros(1), guess=known)
    second = Phase(along, Midpoint(Addition(LINE)), 2, 1.0, end=np.array([4.0]))
    before, after = guess_phases([first, second], [True])
    assert before.guess is known
    np.testing.assert_allclose(after.guess.states[:, 0], [2.5, 3.5], rtol=1e-12)


BODY, ANGLE, AXIS = SO(3) * Euclidean(3), 2.0, np.array([0.0, 0.0, 1.0])
TARGET = np.array([[np.cos(ANGLE), -np.sin(ANGLE), 0], [np.sin(ANGLE), np.cos(ANGLE), 0], [0, 0, 1.0]])


def turning(q, u, torque):
    return q[0] @ hat(q[1]), torque * AXIS + 0 * q[1]


def turned(a, b, torque):
    return jnp.stack([(TARGET.T @ b[0])[0, 1], b[1][2]])


BY_TORQUE = BODY, turning, lambda q, u, torque: 1.0, 0
TURNS = OptimalControlProblem(*BY_TORQUE), OptimalControlProblem(*BY_TORQUE, boundary_constraints={"end": turned})


def turn(attitude, guesses):
    method, end = Gauss(4, Cayley(BODY)), (Free(TARGET), Free(np.zeros(3)))
    return [
        Phase(TURNS[0], method, 4, Free(guesses[0]), start=(attitude, np.zeros(3)), parameters=1.0),
        Phase(TURNS[1], method, 4, Free(guesses[1]), end=end, parameters=-1.0),
    ]


@pytest.mark.slow
def test_bang_bang_arcs_of_an_attitude():
    """A turn by a about a principal axis with ``|u| = 1``: two arcs of ``sqrt(a)``."""
    found = solve_phases(turn(np.eye(3), (1.2, 1.0)))
    np.testing.assert_allclose(found.durations, np.sqrt(ANGLE), rtol=1e-9)
    # dT by angle and rate.
    np.testing.assert_allclose(found.phases[1].multipliers["end"], np.sqrt([0.5, 1.0]), rtol=1e-8)
    assert found.strict_minimum


@pytest.mark.slow
@pytest.mark.parametrize("tilt", [0.0, 1e-15, 1e-12, 1e-9, 1e-8, 1.5e-8, 2e-8, 3e-8, 1e-7, 1e-5, 1e-3, 0.1])
def test_a_tilt_of_any_size_that_nothing_moves_measures_nothing(tilt):
    """A body that is tilted by d turns about its axis by ``atan2(sin a cos d, cos a)``."""
    attitude = np.array([[1, 0, 0], [0, np.cos(tilt), -np.sin(tilt)], [0, np.sin(tilt), np.cos(tilt)]])
    angle = np.arctan2(np.sin(ANGLE) * np.cos(tilt), np.cos(ANGLE))
    for guesses in ((1.2, 1.0), (0.3, 2.0)):
        found = solve_phases(turn(attitude, guesses))
        np.testing.assert_allclose(found.durations, np.sqrt(angle), rtol=1e-8)


@pytest.mark.slow
def test_an_arc_that_rests_between_two_that_do_not():
    """Turnpike: ``x' = u``, ``|u| <= 1``, ``int_0^2 x^2`` from 1 to 1/2 is 3/8; the sum of the durations is given."""
    problem = OptimalControlProblem(LINE, lambda q, u, rate: rate + 0 * q, lambda q, u, rate: q @ q, 0)
    ends: list = [{"start": np.ones(1)}, {}, {"end": np.array([0.5])}]
    given = zip((0.9, 0.6, 0.5), (-1.0, 0.0, 1.0), ends, strict=True)
    phases = [Phase(problem, ALONG, 2, Free(t), parameters=rate, **end) for t, rate, end in given]
    found = solve_phases(phases, horizon=2.0)
    np.testing.assert_allclose(found.times, [0, 1, 1.5, 2], atol=1e-10)
    assert found.cost == pytest.approx(3 / 8, abs=1e-13)
    assert abs(found.multipliers["horizon"][0]) < 1e-10


def rocket(dry, duration=0.15):
    """Two stages: exhaust velocities 3 and 2, masses burn at rate 1, the first drops its dry mass; the final mass is
    largest."""
    burning = OptimalControlProblem(
        PLANE, lambda q, u, c: jnp.stack([c / q[1], -1.0 + 0 * q[1]]), lambda q, u, c: 0.0, 0
    )
    last = OptimalControlProblem(
        PLANE,
        burning.dynamics,
        burning.running_cost,
        0,
        terminal_cost=lambda q, c: -q[1],
        boundary_constraints={"speed": speed},
    )
    method = Gauss(4, Addition(PLANE))
    return [
        Phase(burning, method, 4, Free(duration), start=np.array([0.0, 1.0]), parameters=3.0),
        Phase(last, method, 12, Free(0.3), parameters=2.0),
    ], [lambda q: q - jnp.array([0.0, dry])]


def speed(a, b, c):
    return b[0] - 2.5


@pytest.mark.parametrize(("free", "end", "cost"), [(0, 3.75, 3.875), (1, 2.0, 6.0)])
def test_a_link_leads_from_the_end_before_to_the_start_after(free, end, cost):
    """From 0 to ``x``, and on from ``2 x + 1`` to 9: one phase takes a unit of time, the other a free time at a price
    of 1/2, in which ``u = 1``. The cost is ``x + (8 - 2 x)^2 / 2``, or ``x^2 / 2 + 8 - 2 x``."""
    times = [Free(2.0) if k == free else 1.0 for k in range(2)]
    moves = [
        OptimalControlProblem(LINE, lambda q, u: u, lambda q, u, k=k: u @ u / 2 + (k == free) / 2, 1) for k in (0, 1)
    ]
    method = Midpoint(Addition(LINE))
    first = Phase(moves[0], method, 2, times[0], start=np.zeros(1))
    found = solve_phases([first, Phase(moves[1], method, 3, times[1], end=np.array([9.0]))], [lambda q: 2 * q + 1])
    one, other = (phase.states[:, 0] for phase in found.phases)
    np.testing.assert_allclose([one[0], one[-1], other[0], other[-1]], [0, end, 2 * end + 1, 9], atol=1e-9)
    assert found.cost == pytest.approx(cost, rel=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("dry", [0.2, 0.33])
def test_staging_of_a_rocket(dry):
    """``ln((m - d) / m_f) = (V - 3 ln(1 / m)) / 2`` is best at the staging mass ``m = 3 d``; the mass costate jumps in
    no way."""
    found = solve_phases(*rocket(dry))
    mass = 3 * dry
    final = (mass - dry) * np.exp(-(2.5 + 3 * np.log(mass)) / 2)
    assert found.durations[0] == pytest.approx(1 - mass, rel=1e-7)
    assert -found.cost == pytest.approx(final, rel=1e-9)
    np.testing.assert_allclose(found.phases[0].costates[-1], found.phases[1].costates[0], rtol=1e-9)
    assert found.phases[1].multipliers["speed"] == pytest.approx(-final / 2, rel=1e-8)
    assert found.strict_minimum


@pytest.mark.slow
def test_a_stage_that_is_best_left_out_is_named():
    """From ``d = 1 / 3`` on the first stage only costs: its duration tends to zero, or to its lower bound."""
    assert not solve_phases(*rocket(1 / 3), throw=False).success
    phases, links = rocket(0.35, 0.05)
    with pytest.raises(ConvergenceError, match=r"The duration of phase [01] tends to zero") as caught:
        solve_phases(phases, links)
    assert str(caught.value).partition("\n\nphase 0\n")[0].count("tends to zero") == 1
    found = solve_phases([phases[0]._replace(duration=Free(0.05, lower=0.01)), phases[1]], links)
    assert found.durations[0] == pytest.approx(0.01, rel=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("second", [0.1, 0.3, 0.45])
@pytest.mark.parametrize("first", [0.02, 0.05, 0.15, 0.5])
def test_a_stage_tends_to_its_bound_from_afar(first, second):
    """From whatever guess of the durations the first stage takes its least time, and the second is not left out."""
    phases, links = rocket(0.35, first)
    phases = [phases[0]._replace(duration=Free(first, lower=0.01)), phases[1]._replace(duration=Free(second))]
    found = solve_phases(phases, links)
    assert found.durations[0] == pytest.approx(0.01, rel=1e-5)
    assert -found.cost == pytest.approx(0.64 * np.exp(-(2.5 + 3 * np.log(0.99)) / 2), rel=1e-6)


def refracted(manifold, method, dynamics, ends, height):
    """Two media above and below ``height(q) = 0``: where the path passes from one to the other is found."""
    costs = [lambda q, u, w=weight: w * u @ u / 2 for weight in (1.0, 3.0)]
    upper = OptimalControlProblem(
        manifold, dynamics, costs[0], 3, boundary_constraints={"interface": lambda a, b: height(b)}
    )
    lower = OptimalControlProblem(manifold, dynamics, costs[1], 3)
    return solve_phases([Phase(upper, method, 4, 1.0, start=ends[0]), Phase(lower, method, 6, 2.0, end=ends[1])])


@pytest.mark.slow
def test_a_path_is_refracted_on_a_sphere_and_in_space():
    """The costate along the interface is continuous, its normal part jumps by the multiplier; the place is the best
    one."""
    a, b = np.array([0.6, 0.0, 0.8]), np.array([0.0, 0.8, -0.6])
    found = refracted(GLOBE, Gauss(2, default_retraction(GLOBE)), lambda q, u: jnp.cross(u, q), (a, b), lambda q: q[2])

    def cost(place):
        q = np.array([np.cos(place), np.sin(place), 0])
        return np.arccos(a @ q) ** 2 / 2 + 3 * np.arccos(q @ b) ** 2 / 4

    best = minimize_scalar(cost, (0.2, 0.8), tol=1e-12)
    q, before, after = found.phases[1].states[0], found.phases[0].costates[-1], found.phases[1].costates[0]
    assert found.cost == pytest.approx(best.fun, rel=1e-7)
    assert np.arctan2(q[1], q[0]) == pytest.approx(best.x, abs=1e-5)
    np.testing.assert_allclose(
        before, after - found.phases[0].multipliers["interface"] * np.array([0, 0, 1.0]), atol=1e-9
    )
    space = Euclidean(3)
    found = refracted(space, Midpoint(Addition(space)), lambda q, u: u, (a, b), lambda q: q[2])
    jump = found.phases[1].costates[0] - found.phases[0].costates[-1]
    np.testing.assert_allclose(jump, [0, 0, found.phases[0].multipliers["interface"][0]], atol=1e-9)


@pytest.mark.slow
def test_a_cycle_of_two_phases():
    """``x' = u``, ``int u^2 / 2 + (x -+ 1)^2 / 2``, one unit of time each: ``x = +-(1 - cosh(t - 1/2) /
    cosh(1/2))``."""
    sides = [
        OptimalControlProblem(LINE, lambda q, u: u, lambda q, u, s=side: u @ u / 2 + (q[0] - s) ** 2 / 2, 1)
        for side in (1, -1)
    ]
    phases = [Phase(problem, ALONG, 4, 1.0) for problem in sides]
    phases[0] = phases[0]._replace(start=Free(np.full(1, 0.3)))
    found = solve_phases(phases, links=[True, True])
    t = found.phases[0].times - 0.5
    for phase, side in zip(found.phases, (1, -1), strict=True):
        np.testing.assert_allclose(phase.states[:, 0], side * (1 - np.cosh(t) / np.cosh(0.5)), atol=1e-8)
    np.testing.assert_allclose(found.phases[1].costates[-1], found.phases[0].costates[0], rtol=1e-9)
    assert found.strict_minimum
    folded = solve_phases(phases[:1], links=[lambda q: -q])  # half of it, reflected
    np.testing.assert_allclose(folded.phases[0].states, found.phases[0].states, atol=1e-11)


@pytest.mark.slow
def test_the_time_goes_on_from_phase_to_phase():
    """A force ``cos 2 pi t`` on a cycle in two phases, as in one."""
    forced = OptimalControlProblem(
        LINE,
        lambda q, u, t: u - q,
        lambda q, u, t: u @ u / 2 + 5 * (q[0] - jnp.cos(2 * jnp.pi * t)) ** 2,
        1,
        time_dependent=True,
    )
    first = Phase(forced, ALONG, 5, 0.4, start=Free(np.zeros(1)))
    found = solve_phases([first, Phase(forced, ALONG, 7, 0.6)], links=[True, True])
    for phase in found.phases:
        exact = 10 * np.cos(2 * np.pi * phase.times) / (11 + 4 * np.pi**2)
        np.testing.assert_allclose(phase.states[:, 0], exact, atol=1e-7)


@pytest.mark.slow
def test_phases_are_one_trajectory():
    """A bounded slew in two phases is the one in one: same steps, same cost, same costates."""
    body = SO(3) * Euclidean(3)
    slew = OptimalControlProblem(
        body, lambda q, u: (q[0] @ hat(q[1]), u), lambda q, u: u @ u / 2, 3, control_bounds=(-2.5, 2.5)
    )
    target = np.array([[np.cos(2.0), -np.sin(2.0), 0], [np.sin(2.0), np.cos(2.0), 0], [0, 0, 1.0]])
    start, end, method = (np.eye(3), np.zeros(3)), (target, np.zeros(3)), Gauss(2, Cayley(body))
    one = solve(slew, start, end, 2.0, method=method, steps=10)
    found = solve_phases([Phase(slew, method, 4, 0.8, start=start), Phase(slew, method, 6, 1.2, end=end)])
    assert found.cost == pytest.approx(one.cost, rel=1e-9)
    for own, whole in zip(found.phases[1].costates, one.costates, strict=True):
        np.testing.assert_allclose(own, whole[4:], atol=1e-7)
    assert found.strict_minimum
    assert one.checks.strict_minimum


def phase(**changes):
    given = {"problem": FORCED, "method": GAUSS, "steps": 2, "duration": Free(1.0), "start": REST, "parameters": 1.0}
    return Phase(**(given | changes))


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (([],), "solve_phases takes a list of at least one Phase"),
        (([phase(), 3],), "solve_phases takes a list of at least one Phase"),
        (([phase(duration=-1.0)],), "phase 0: duration must be a positive finite time"),
        (
            ([phase(), phase(duration=Free(-1.0))],),
            "phase 1: duration must be a positive finite time, or Free, got Free",
        ),
        (([phase(start=None)],), r"phase 0 has a start that is free, and nothing .* try start=Free"),
        (([phase(), phase()], [None]), r"links\[0\] must be True for a continuous state"),
        (([phase(), phase()], [True, True, True]), r"links must be a list of 1, one from each phase to the next"),
        (
            ([phase(), phase(problem=OptimalControlProblem(LINE, lambda q, u: u, lambda q, u: 1.0, 1), method=ALONG)],),
            r"from R\^2 to R\^1",
        ),
        (([phase(), phase(start=None)], [lambda q: q[:1]]), r"the value of links\[0\], a point"),
        (([phase(duration=1.0)], None, 2.0), r"horizon\[0\] depends on"),
        (([phase()], None, np.nan), r"horizon must be a positive finite time, the sum .*, got nan"),
        (
            ([phase()], None, None, {"a": 3}),
            r"boundary_constraints\['a'\] must be a function of the ends of all phases",
        ),
        (([phase()], None, 2.0, {"horizon": lambda ends: 0.0}), r"\['horizon'\] has a name under which"),
        (
            ([phase()], None, None, {"start of phase 0": lambda ends: 0.0}),
            r"\['start of phase 0'\] has a name under which",
        ),
        (([phase()], None, None, None, 3), r"guess must be a PhasedSolution of 1 phase, got 3; try"),
        (([phase(guess=3)],), r"phase 0: guess must be a Guess or a Solution, got 3; try"),
        (([phase(parameters=None)],), r"phase 0: the problem's functions take parameters, and none are given"),
        (([phase(start=np.zeros(3))],), r"phase 0: start: a point of R\^2 has shape"),
        (
            ([phase(problem=OptimalControlProblem(PLANE, lambda q, u: u, lambda q, u: 1.0, 2), parameters=None)],),
            r"phase 0: the problem is singular",
        ),
    ],
)
@pytest.mark.usual(3)
def test_what_are_no_phases_is_named(given, words):
    with pytest.raises((InvalidInputError, ValueError), match=words):
        solve_phases(*given)


@pytest.mark.slow
def test_boundary_constraints_of_all_phases():
    """Both arcs of equal length, though the second brakes twice as hard: from rest over L to the speed that is left."""
    phases = [
        bang_bang(1.0, (1.0, 1.0))[0],
        Phase(FORCED, GAUSS, 2, Free(1.0), end=Free(np.array([1.0, 0.0])), parameters=-0.5),
    ]
    between = {
        "same": lambda ends: ends[0].duration - ends[1].duration,
        "there": lambda ends: ends[1].end[0] - 1.0,
    }
    found = solve_phases(phases, boundary_constraints=between)
    t = np.sqrt(1 / (0.5 + 1 - 0.25))
    np.testing.assert_allclose(found.durations, t, rtol=1e-10)
    assert set(found.multipliers) == {"same", "there"}
    assert found.multipliers["there"] == pytest.approx(-t, rel=1e-9)  # of 2 t by the length, which is 5 t^2 / 4


def test_a_line_through_a_point_that_is_asked_for_between_two_phases():
    """From 0 to 1 by ``x' = u`` through .3 halfway: each phase moves at one speed, and the multiplier is what the
    costate jumps by."""
    problem = OptimalControlProblem(LINE, lambda q, u: u, lambda q, u: u @ u / 2, 1)
    method = Midpoint(Addition(LINE))
    phases = [
        Phase(problem, method, 2, 1.0, start=np.zeros(1)),
        Phase(problem, method, 3, 1.0, end=np.ones(1)),
    ]
    found = solve_phases(phases, boundary_constraints={"halfway": lambda ends: ends[0].end[0] - 0.3})
    assert found.success
    speeds = [0.3, 0.7]
    for own, speed in zip(found.phases, speeds, strict=True):
        np.testing.assert_allclose(own.controls, speed, rtol=1e-10)
    assert found.cost == pytest.approx(sum(np.square(speeds)) / 2, rel=1e-12)
    jump = found.phases[1].costates[0] - found.phases[0].costates[-1]
    np.testing.assert_allclose(np.abs(found.multipliers["halfway"]), np.abs(jump), rtol=1e-9)
