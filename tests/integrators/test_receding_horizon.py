"""Receding horizon control and closed loops, against regulators, open-loop optima, SciPy and other plans."""

from functools import cache

import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import pytest
import retrax as rx
from retrax.integrators import soften
from retrax.integrators.closed_loop.plan import Budget
from retrax.integrators.closed_loop.plant import Plant, Signal
from retrax.interop import to_pandas
from retrax.manifolds import DomainError, InvalidInputError
from scipy.integrate import solve_ivp
from scipy.linalg import expm, solve_continuous_are
from scipy.spatial.transform import Rotation

SYSTEM, INPUT = np.array([[0.0, 1.0], [0.5, -0.3]]), np.array([[0.0], [1.0]])
WEIGHT, PRICE, BOUND = np.diag([2.0, 0.5]), 0.4, 1.5
GAIN = INPUT.T @ solve_continuous_are(SYSTEM, INPUT, WEIGHT, PRICE * np.eye(1)) / PRICE
PLANE = rx.Euclidean(2)
AWAY = np.array([1.0, -0.5])

BODY = rx.SO(3) * rx.Euclidean(3)
INERTIA, TORQUE, RATE = np.array([3.0, 2.0, 1.5]), 0.6, 0.5
START = np.eye(3), np.zeros(3)
END = Rotation.from_rotvec([0.5, 1.0, -0.8]).as_matrix(), np.zeros(3)
TIME, SAMPLE, REST, EXACT = 8.0, 0.5, np.zeros(3), 1e-11


def linear(q, u):
    return SYSTEM @ q + INPUT @ u


def quadratic(q, u):
    return q @ WEIGHT @ q / 2 + PRICE * u @ u / 2


def body(q, u, push):
    return q[0] @ rx.hat(q[1]), (u + push - jnp.cross(q[1], INERTIA * q[1])) / INERTIA


@cache
def regulated(bound=np.inf):
    """The solver of the linear-quadratic problem with a bound."""
    problem = rx.OptimalControlProblem(PLANE, linear, quadratic, 1, control_bounds=(-bound, bound))
    return rx.Solver(problem, rx.Gauss(2 if bound < np.inf else 3, rx.default_retraction(PLANE)), steps=30)


@cache
def turning():
    """The solver of a rigid body with limits of torque and rate; the parameter is a torque that disturbs it."""
    problem = rx.OptimalControlProblem(
        BODY,
        body,
        lambda q, u: u @ u / 2,
        3,
        control_bounds=(-TORQUE, TORQUE),
        constraints={"rate": lambda q, u: q[1] @ q[1] / RATE**2 - 1},
    )
    return rx.Solver(problem, rx.Gauss(2, rx.Cayley(BODY)), steps=16)


@cache
def best():
    """The open-loop optimum without a disturbance."""
    return turning().solve(START, END, TIME, parameters=REST)


def angles(attitudes, others):
    """The angles between rotations in rad."""
    return (Rotation.from_matrix(attitudes).inv() * Rotation.from_matrix(others)).magnitude()


def misaligned(q, t, rng):
    """A measured attitude and rate."""
    turn = Rotation.from_rotvec(1e-2 * rng.normal(size=3)).as_matrix()
    return q[0] @ turn, q[1] + 1e-3 * rng.normal(size=3)


def test_a_long_horizon_is_the_linear_quadratic_regulator():
    errors = []
    for steps in (20, 40, 80):
        controller = rx.RecedingHorizon(regulated().with_steps(steps), None, horizon=20.0)
        errors.append(abs(controller(AWAY, 0.0) + GAIN @ AWAY).max())
    assert errors[-1] <= 1e-3
    assert np.log2(errors[1] / errors[2]) >= 2.5  # the controls between the stages are of order 3
    controller = rx.RecedingHorizon(regulated().with_steps(80), None, horizon=20.0)
    loop = rx.simulate(regulated().problem, controller, AWAY, horizon=3.0, sample_time=0.25)
    exact = np.stack([expm((SYSTEM - INPUT @ GAIN) * t) @ AWAY for t in loop.t])
    assert abs(loop.q - exact).max() <= 1e-4
    assert set(loop.solves.sources) == {"solve"}
    assert loop.solves.iterations.max() == 1


def test_a_shifted_guess_is_the_trajectory_to_the_order_of_the_interpolation():
    reference = turning().with_steps(128).solve(START, END, TIME, parameters=REST, guess=best())
    errors = []
    for steps in (16, 32, 64):
        plan = turning().with_steps(steps).solve(START, END, TIME, parameters=REST, guess=best())
        guess = plan.guess(after=1.3, horizon=TIME)
        times = 1.3 + plan.times
        expected = reference(np.minimum(times, TIME)).states
        errors.append(max(angles(guess.nodes[0], expected[0]).max(), abs(guess.nodes[1] - expected[1]).max()))
        late = times >= TIME
        assert late.any()
        assert angles(guess.nodes[0][late], END[0]).max() <= 1e-12
        assert plan.guess(after=1.3).nodes[1].shape == guess.nodes[1].shape
    assert errors[-1] <= 1e-6
    assert np.log2(errors[0] / errors[2]) / 2 >= 2.5


def test_an_undisturbed_loop_to_a_fixed_end_is_the_open_loop_optimum():
    solver = turning().with_steps(32)
    optimum = solver.solve(START, END, TIME, parameters=REST, guess=best())
    controller = rx.RecedingHorizon(solver, END, end_time=TIME, parameters=REST, tolerance=EXACT)
    loop = rx.simulate(solver.problem, controller, START, TIME, SAMPLE, parameters=REST)
    expected = optimum(loop.t).states
    assert angles(loop.q[0], expected[0]).max() <= 1e-6
    assert abs(loop.q[1] - expected[1]).max() <= 1e-6
    assert loop.solves.iterations[1:].max() <= 3
    assert set(loop.solves.sources) == {"solve"}


@pytest.mark.parametrize("most", [1, 2, 3, None])
@pytest.mark.usual(1)
def test_a_budget_of_iterations_keeps_the_loop_stable_and_each_fallback_is_counted(most):
    controller = rx.RecedingHorizon(turning(), END, horizon=TIME, parameters=REST, max_iterations=most, hold=SAMPLE)
    pushes = {"parameters": lambda t, rng: 2e-2 * rng.normal(size=3), "measure": misaligned}
    loop = rx.simulate(turning().problem, controller, START, 20.0, SAMPLE, **pushes)
    solves = loop.solves
    assert angles(loop.q[0][-8:], END[0]).max() <= 0.1
    assert abs(loop.u).max() <= TORQUE
    assert solves.iterations[1:].max() <= (most or 100)
    assert set(solves.failures) == {
        t for t, source in zip(solves.times, solves.sources, strict=True) if source != "solve"
    }
    assert solves.fallbacks == solves.sources.count("feedback") + solves.sources.count("plan")
    assert (solves.sources.count("solve") == 1) == (most == 1)
    assert (f"{solves.sources.count('iterate')} by iterates" in repr(solves)) == (most in (1, 2))


@pytest.mark.parametrize("bound", [0.3, 1.5, np.inf])
def test_a_fallback_is_the_feedback_along_the_plan_within_the_bounds(bound):
    solver = regulated(bound)
    controller = rx.RecedingHorizon(solver, None, horizon=6.0, max_iterations=1, acceptable=0.0)
    controller(0.2 * AWAY, 0.0)
    for t, size in ((0.4, 0.05), (0.8, 0.5), (1.2, 5.0)):
        q, plan, begin = np.array([size, -size]), controller.plan, controller.plan_begin
        control = controller(q, t)
        if controller.statistics.sources[-1] == "feedback":  # a problem without bounds is solved in one iteration
            assert controller.plan is plan
            law = solver.feedback(plan)(t - begin, q)
            assert control == pytest.approx(np.clip(law, -bound, bound), abs=1e-12)
            assert t in controller.statistics.failures
        assert abs(control).max() <= bound
    assert ("feedback" in controller.statistics.sources) == (bound < np.inf)


def test_a_late_control_that_is_predicted_is_that_of_a_loop_without_a_delay():
    delay, start = 0.3, (np.eye(3), np.array([0.05, -0.02, 0.03]))
    problem, rest = turning().problem, Signal.constant(REST)
    later = Plant(problem).advance(start, rest, 0.0, delay, REST)
    in_time = rx.RecedingHorizon(turning(), END, end_time=TIME - delay, parameters=REST, tolerance=EXACT)
    expected = rx.simulate(problem, in_time, later, TIME - SAMPLE, SAMPLE, parameters=REST)
    controls, given = {}, {"end_time": TIME, "parameters": REST, "tolerance": EXACT}
    for known in (0.0, delay):
        controller = rx.RecedingHorizon(turning(), END, delay=known, **given)
        loop = rx.simulate(problem, controller, start, TIME - SAMPLE, SAMPLE, parameters=REST, delay=delay)
        controls[known] = loop.u
    assert abs(controls[delay] - expected.u).max() <= 1e-9
    assert abs(controls[0.0] - expected.u).max() >= 1e-3


def test_a_soft_constraint_is_exact_and_admits_a_state_that_violates_it():
    weight, fast = 20.0, (np.eye(3), np.array([0.0, 1.2 * RATE, 0.0]))
    tight = turning().solve(START, END, 4.5, parameters=REST)
    assert 0 < tight.multipliers["rate"].max() < weight
    assert not turning().solve(fast, END, 4.5, parameters=REST, guess=tight, throw=False, max_iterations=20).success
    given = {"horizon": 4.5, "parameters": REST, "soft": {"rate": weight}}
    controller = rx.RecedingHorizon(turning(), END, tolerance=EXACT, **given)
    assert controller(START, 0.0).shape == (3,)
    assert controller.plan.cost == pytest.approx(tight.cost, rel=1e-8)
    assert controller.plan.u[:, 3].max() <= 1e-8
    controller = rx.RecedingHorizon(turning(), END, **given)
    controller(START, 0.0)
    controller(fast, 0.5)
    assert controller.statistics.sources == ("solve", "solve")
    assert controller.plan.u[0, 3] == pytest.approx(1.2**2 - 1, abs=0.1)


def test_a_plant_moves_as_scipy_integrates_it():
    problem, push, torque = turning().problem, np.array([0.1, -0.3, 0.2]), np.array([0.5, 0.2, -0.4])
    q = START[0], np.array([0.4, -0.3, 0.8])
    found = Plant(problem).advance(q, Signal.constant(torque), 0.0, 5.0, push)

    def velocity(t, x):
        spin, w = x[:9].reshape(3, 3) @ np.asarray(rx.hat(x[9:])), x[9:]
        return np.append(spin.ravel(), (torque + push - np.cross(w, INERTIA * w)) / INERTIA)

    end = solve_ivp(velocity, (0.0, 5.0), np.append(q[0].ravel(), q[1]), rtol=1e-12, atol=1e-13).y[:, -1]
    assert abs(found[0].ravel() - end[:9]).max() <= 1e-8
    assert abs(found[1] - end[9:]).max() <= 1e-8
    assert abs(found[0] @ found[0].T - np.eye(3)).max() <= 1e-13
    stiff = rx.OptimalControlProblem(rx.Euclidean(1), lambda q, u: -1e6 * (q - u), lambda q, u: u @ u, 1)
    with pytest.raises(DomainError, match="stiff"):
        Plant(stiff).advance(np.ones(1), Signal.constant(np.zeros(1)), 0.0, 1.0)


def test_a_closed_loop_is_saved_drawn_and_written_as_a_table(tmp_path):
    problem = regulated(BOUND).problem
    controller = rx.RecedingHorizon(regulated(BOUND), None, horizon=6.0, max_iterations=2, hold=0.1)
    noise = {"measure": lambda q, t, rng: q + 1e-2 * rng.normal(size=2), "seed": 3}
    loop = rx.simulate(problem, controller, AWAY, 1.0, 0.1, **noise)
    loop.save(tmp_path / "loop.npz")
    again = rx.load(tmp_path / "loop.npz")
    for name in ("times", "states", "stage_times", "controls", "measured"):
        assert np.array_equal(getattr(again, name), getattr(loop, name))
    assert again.quantities == loop.quantities
    assert repr(again) == repr(loop)
    assert again.solves.failures == loop.solves.failures
    assert to_pandas(loop).shape == (11, 2)
    assert to_pandas(loop, "stages").iloc[3, 0] == loop.u[3, 0]
    axes = loop.plot()
    assert np.array_equal(axes[1].lines[0].get_ydata()[:-1], loop.u[:, 0])
    plt.close("all")
    simple = rx.simulate(problem, lambda q, t: -GAIN @ q, AWAY, 1.0, 0.1)
    assert simple.solves is None
    simple.save(tmp_path / "simple.npz")
    assert rx.load(tmp_path / "simple.npz").solves is None
    with pytest.raises(InvalidInputError, match="load_closed_loop"):
        rx.integrators.load_solution(tmp_path / "loop.npz")


def test_a_moving_window_begins_where_a_shrinking_horizon_ends():
    controller = rx.RecedingHorizon(regulated(BOUND), None, horizon=2.0, end_time=3.0, parameters=None)
    horizons = []
    for t in (0.0, 0.5, 1.0, 1.5, 2.0, 4.0):
        controller(AWAY, t)
        horizons.append(controller.plan.horizon)
    assert horizons == pytest.approx([3.0, 2.5, 2.0, 2.0, 2.0, 2.0])


def test_a_reference_and_parameters_may_be_functions_of_time():
    seen = []

    def target(t):
        seen.append(t)
        return np.array([t, 1.0])

    controller = rx.RecedingHorizon(regulated(), target, horizon=2.0)
    controller(AWAY, 0.5)
    assert seen == [2.5]
    assert controller.plan.q[-1] == pytest.approx([2.5, 1.0])
    controller(AWAY, 1.0, reference=np.zeros(2))
    assert controller.plan.q[-1] == pytest.approx([0.0, 0.0])


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (lambda: rx.RecedingHorizon(regulated().problem, None, 1.0), "takes a Solver"),
        (lambda: rx.RecedingHorizon(regulated(), None), "got neither"),
        (lambda: rx.RecedingHorizon(regulated(), None, horizon=-1.0), "horizon must be a positive"),
        (lambda: rx.RecedingHorizon(regulated(), None, horizon=1.0, delay=-1.0), "delay must be"),
        (lambda: rx.RecedingHorizon(regulated(), None, horizon=1.0, max_iterations=0), "at least 1, got 0"),
        (lambda: rx.RecedingHorizon(regulated(), None, horizon=1.0)(AWAY, "now"), "t must be a finite time"),
        (lambda: rx.RecedingHorizon(regulated(), None, horizon=1.0, budget=1.0), "no option 'budget'"),
        (lambda: rx.RecedingHorizon(regulated(), None, horizon=1.0).plan, "before the first call"),
        (lambda: rx.RecedingHorizon(regulated(), None, end_time=1.0)(AWAY, 1.0), "give horizon"),
        (lambda: soften(regulated().problem, {"rate": 1.0}), "no constraint 'rate'"),
        (lambda: soften(turning().problem, {"rate": 0.0}), "try ten times"),
        (lambda: rx.simulate(regulated(), None, AWAY, 1.0, 0.1), "the plant must be"),
        (lambda: rx.simulate(regulated().problem, lambda q, t: -q, AWAY, 1.0, 0.1), "control of the controller"),
        (lambda: rx.simulate(regulated().problem, lambda q, t: -q, AWAY, 1.0, 0.3), "try horizon=0.9"),
        (lambda: rx.simulate(turning().problem, lambda q, t: REST, START, 1.0, 0.5), "parameters"),
    ],
)
def test_other_input_raises_an_error_with_a_hint(wrong, words):
    with pytest.raises((InvalidInputError, TypeError), match=words):
        wrong()


def test_a_time_that_is_not_later_raises_an_error():
    controller = rx.RecedingHorizon(regulated(), None, horizon=1.0)
    controller(AWAY, 1.0)
    with pytest.raises(InvalidInputError, match="not later"):
        controller(AWAY, 1.0)


def test_a_budget_in_milliseconds_leaves_room_for_an_iteration_as_long_as_the_longest(monkeypatch):
    clock = iter([0.0, 0.001, 0.003, 0.008, 0.009])
    monkeypatch.setattr("retrax.integrators.closed_loop.plan.time.perf_counter", lambda: next(clock))
    budget = Budget(None, 12.0)
    assert [budget(None) for _ in range(4)] == [False, False, True, True]


@pytest.mark.parametrize("evaluator", ["tape", "xla"])
def test_a_softened_problem_is_evaluated_as_the_user_chose(evaluator):
    line = rx.Euclidean(1)
    problem = rx.OptimalControlProblem(
        line, lambda q, u: u, lambda q, u: u @ u / 2, 1, constraints={"wall": lambda q, u: q[0] - 1}
    )
    solver = rx.Solver(problem, rx.Midpoint(rx.Exponential(line)), steps=4, evaluator=evaluator)
    assert rx.RecedingHorizon(solver, None, horizon=1.0, soft={"wall": 10.0}).solver.evaluator == evaluator
