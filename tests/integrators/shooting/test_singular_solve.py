"""Singular boundary-value problems: extremals in closed form, and boundary data that admit none."""

from functools import cache

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array
from retrax.integrators import (
    Composition,
    OptimalControlProblem,
    Result,
    Solution,
    classify,
    integrate,
    load_solution,
    solve,
)
from retrax.integrators.singular import Classification, singular_integrator
from retrax.integrators.singular.strategies import RattleIntegrator
from retrax.manifolds import ConvergenceError, Euclidean, InvalidInputError
from retrax.problems import SINGULAR
from retrax.retractions import Cayley, CotangentLift, Exponential, Midpoint, Theta

from tests.integrators.problems import INERTIA, rotation
from tests.support.numerics import norm

LINE = Euclidean(1)
PLANE = LINE * LINE  # the two states are factors, so that each can be free
MIDPOINT = Midpoint(Exponential(PLANE))
ZERO, ONE = np.zeros(1), np.ones(1)


def cascade(cost, first=lambda q, u: q[1]) -> OptimalControlProblem:
    """``x1' = x2`` or another function of state and controls, ``x2' = u``."""
    return OptimalControlProblem(PLANE, lambda q, u: (first(q, u), u[-1:]), cost, 1)


ALY_CHAN = cascade(lambda q, u: (q[1] @ q[1] - q[0] @ q[0]) / 2)


def order(errors: list[float]) -> float:
    """The order of a method from its errors with some number of steps and with twice as many."""
    return float(np.log2(errors[0] / errors[1]))


@cache
def classified(problem: OptimalControlProblem) -> Classification:
    return classify(problem, starts=8)


@cache
def aly_chan(steps: int) -> Solution:
    """From 0 to 1 in a quarter of a period, both rates free: ``x1 = sin t``, of cost zero."""
    return solve(
        ALY_CHAN,
        (ZERO, None),
        (ONE, None),
        np.pi / 2,
        method=MIDPOINT,
        steps=steps,
        classification=classified(ALY_CHAN),
    )


@pytest.mark.slow
def test_aly_chan_turns_in_the_plane_of_the_midpoint_rule():
    """Steps of the midpoint rule turn ``(x1, x2)`` by the angle ``2 arctan(h/2)``: a sine, whatever the step."""
    solution = aly_chan(8)
    turns = np.arange(9) * 2 * np.arctan(np.pi / 32)
    assert solution.success
    assert norm(solution.states[0][:, 0] - np.sin(turns) / np.sin(turns[-1])) < 1e-13
    assert norm(solution.states[1][:, 0] - np.cos(turns) / np.sin(turns[-1])) < 1e-13
    assert norm(solution.costates[1]) < 1e-13
    assert norm(solution.costates[0] - solution.states[1]) < 1e-13
    assert norm(solution.controls + solution.stage_states[0]) < 1e-13
    assert solution.checks.defect < 1e-13
    assert solution.checks.stationarity < 1e-14


@pytest.mark.slow
def test_aly_chan_is_a_sine_to_order_two():
    solutions = [aly_chan(n) for n in (8, 16)]
    assert order([norm(s.states[0][:, 0] - np.sin(s.times)) for s in solutions]) == pytest.approx(2.0, abs=0.03)
    assert order([norm(s.controls[:, 0] + np.sin(s.stage_times)) for s in solutions]) == pytest.approx(2.0, abs=0.1)
    assert order([abs(s.cost) for s in solutions]) == pytest.approx(2.0, abs=0.03)


@pytest.mark.slow
def test_a_singular_extremal_is_a_curve_between_its_nodes_and_a_guess_for_another_mesh():
    """Of order two with states and costates, piecewise constant with controls."""
    times = np.linspace(0.0, np.pi / 2, 101)
    curves = [aly_chan(n)(times) for n in (8, 16)]
    assert order([norm(c.states[0][:, 0] - np.sin(times)) for c in curves]) == pytest.approx(2.0, abs=0.1)
    assert (
        order([norm(c.costates[0] - c.states[1]) for c in curves]) > 1.9
        or norm(curves[1].costates[0] - curves[1].states[1]) < 1e-13
    )
    assert order([norm(c.controls[:, 0] + np.sin(times)) for c in curves]) == pytest.approx(1.0, abs=0.1)
    ends = (ZERO, None), (ONE, None)
    fine = solve(
        ALY_CHAN, *ends, np.pi / 2, method=MIDPOINT, steps=16, guess=aly_chan(8), classification=classified(ALY_CHAN)
    )
    assert fine.success
    assert fine.cost == pytest.approx(aly_chan(16).cost, abs=1e-12)


def test_a_singular_solution_reports_what_was_checked(tmp_path):
    solution = aly_chan(8)
    arc = solution.singular
    assert (arc.dimension, arc.kernel, arc.gauge_controls, arc.independent) == (2, 0, 0, 2)
    assert arc.presymplectic
    assert "strict generalised Legendre-Clebsch condition met" in arc.second_order
    assert not solution.checks.strict_minimum
    assert list(arc.conditions) == [
        f"{end}, factor {i}: {kind}" for end in ("end", "start") for i, kind in enumerate(("state", "costate"))
    ]
    report = " ".join(str(solution).split())
    for words in (arc.strategy, arc.second_order, "equations of P_f", "2 coordinates of them independent"):
        assert " ".join(words.split()) in report
    assert max(map(len, str(solution).splitlines())) <= 130
    solution.save(tmp_path / "arc.npz")
    loaded = load_solution(tmp_path / "arc.npz")
    assert loaded.singular == arc
    assert str(loaded) == str(solution)


def test_a_rate_prescribed_on_both_sides_is_refused_with_what_is_missed():
    options = {"classification": classified(ALY_CHAN)}
    solution = solve(ALY_CHAN, (ZERO, ZERO), (ONE, ZERO), np.pi / 2, method=MIDPOINT, steps=8, throw=False, **options)
    assert not solution.success
    assert solution.result == Result[Result.no_extremal]
    assert max(solution.singular.conditions.values()) > 0.1
    assert "too coarse" not in str(solution)  # the Hamiltonian of what is no extremal means nothing
    with pytest.raises(ConvergenceError, match=r"(?s)contradict each other.*start, factor 1:\s+state missed by"):
        solve(ALY_CHAN, (ZERO, ZERO), (ONE, ZERO), np.pi / 2, method=MIDPOINT, steps=8, **options)


def test_an_accuracy_is_for_regular_problems():
    options = {"classification": classified(ALY_CHAN), "accuracy": 1e-6}
    with pytest.raises(InvalidInputError, match="only the mesh of a regular problem is refined"):
        solve(ALY_CHAN, (ZERO, None), (ONE, None), np.pi / 2, method=MIDPOINT, steps=8, **options)


@pytest.mark.slow
def test_a_momentum_that_no_symmetry_conserves_is_not_ascribed_to_the_problem():
    """``p2`` is zero on ``P_f``; ``H`` depends on both states."""
    solution = solve(
        ALY_CHAN, (ZERO, None), (ONE, None), 1.0, method=MIDPOINT, steps=8, classification=classified(ALY_CHAN)
    )
    assert list(solution.checks.conserved.values()) == [0, 1]
    report = " ".join(str(solution).split())
    assert "constant along this extremal: none of 1 components" in report
    assert "constant along this extremal: 1 of 1 components" in report


class Growth(eqx.Module):
    """``x' = a x + u1``, ``y' = y``."""

    rate: Array

    def __call__(self, q, u):
        return self.rate * q[0] + u[:1], q[1]


def academic_cost(q, u):
    return (q[0] @ q[0] + q[1] @ q[1] + u[0] ** 2) / 2 + q[0][0] * u[0] + q[1][0] * u[1]


def height(q):
    return q[1][0]


@cache
def academic(rate: float) -> tuple[OptimalControlProblem, Classification]:
    """The example of the paper: ``P_f = {y = 0}``, ``u1 = p_x - x``, and ``u2`` is gauge."""
    problem = OptimalControlProblem(PLANE, Growth(jnp.asarray(rate)), academic_cost, 2, terminal_cost=height)
    return problem, classify(problem, starts=8)


def solve_academic(rate: float, start, end, steps: int = 12, **options) -> Solution:
    problem, c = academic(rate)
    return solve(problem, start, end, 1.0, method=MIDPOINT, steps=steps, classification=c, **options)


@pytest.mark.slow
@pytest.mark.parametrize("rate", [0.0, 0.5])
@pytest.mark.parametrize("target", [-0.2, None])
def test_the_example_of_the_paper_in_closed_form(rate, target):
    """``p = p0 e^{ct}`` and ``x = x0 e^{-ct} + p0 sinh(ct) / c`` with ``c = 1 - a``; at a free end ``p = 0``."""
    c, x0 = 1 - rate, 0.7
    solution = solve_academic(rate, (x0 * ONE, ZERO), (target if target is None else target * ONE, ZERO))
    p0 = 0.0 if target is None else (target - x0 * np.exp(-c)) * c / np.sinh(c)
    t = solution.times
    assert norm(solution.costates[0][:, 0] - p0 * np.exp(c * t)) < 3e-3
    assert norm(solution.states[0][:, 0] - x0 * np.exp(-c * t) - p0 * np.sinh(c * t) / c) < 3e-3
    assert norm(solution.states[1]) < 1e-12
    assert norm(solution.controls[:, 1]) < 1e-9  # nothing asks for the gauge control, so that the least is none
    assert "gauge" in solution.singular.second_order


@pytest.mark.slow
def test_gauge_controls_have_the_least_norm_that_meets_the_ends():
    """``p_y' = -p_y + u2`` from 0 to -1, the slope of the terminal cost: ``u2 = -e^t / sinh 1``, or its discrete
    counterpart."""
    solution, h = solve_academic(0.0, (0.7 * ONE, None), (None, None)), 1 / 12
    assert "of least norm that meet the ends" in " ".join(solution.singular.strategy.split())
    reach = h / (1 + h / 2) * ((1 - h / 2) / (1 + h / 2)) ** np.arange(11, -1, -1)
    assert norm(solution.controls[:, 1] + reach / (reach @ reach)) < 1e-9
    assert norm(solution.controls[:, 1] + np.exp(solution.stage_times) / np.sinh(1.0)) < 3e-3
    assert solution.costates[1][[0, -1], 0] == pytest.approx([0, -1], abs=1e-11)
    assert solution.singular.kernel == solution.singular.gauge_controls == 1


@pytest.mark.slow
def test_a_start_off_the_final_manifold_is_refused_with_the_equation_it_contradicts():
    with pytest.raises(
        InvalidInputError, match=r"at the start .*factor 0, start, factor 1 prescribed.*primary equation = -?0\.\d+"
    ):
        solve_academic(0.0, (0.7 * ONE, 0.5 * ONE), (None, None))
    with pytest.raises(InvalidInputError, match=r"at the end .*contradict: primary equation"):
        solve_academic(0.0, (0.7 * ONE, ZERO), (None, 0.5 * ONE))


def test_an_empty_final_manifold_is_said_to_be_empty():
    problem = OptimalControlProblem(LINE, lambda q, u: u, lambda q, u: q[0], 1)
    with pytest.raises(InvalidInputError, match="no point of P_f, on which"):
        solve(problem, ZERO, ONE, 1.0, method=Midpoint(Exponential(LINE)), steps=4)


@pytest.mark.slow
def test_a_partially_singular_problem_in_closed_form():
    """``x1' = x2 + w``, ``x2' = u``, cost ``(w^2 + x1^2 + x2^2)/2``: ``w = x2 = p1``, so ``x1'' = 2 x1``."""
    problem = OptimalControlProblem(
        PLANE, lambda q, u: (q[1] + u[:1], u[1:]), lambda q, u: (u[0] ** 2 + q[0] @ q[0] + q[1] @ q[1]) / 2, 2
    )
    solution = solve(problem, (ONE, None), (None, None), 1.0, method=MIDPOINT, steps=12)
    exact = np.cosh(np.sqrt(2) * (1 - solution.times)) / np.cosh(np.sqrt(2))
    assert norm(solution.states[0][:, 0] - exact) < 1e-3
    assert norm(solution.states[1] - solution.costates[0]) < 1e-12
    assert "strict generalised Legendre-Clebsch condition met" in solution.singular.second_order


@pytest.mark.slow
def test_where_no_cost_is_on_it_the_control_of_least_norm_reaches_the_end():
    """``H = p1 x2 + p2 u + p3 w - w^2 / 2``: on ``P_f`` ``p1 = p2 = 0``, and ``u`` is gauge: of least square sum."""
    steps, h, space = 12, 1 / 12, LINE * LINE * LINE
    problem = OptimalControlProblem(space, lambda q, u: (q[1], u[:1], u[1:]), lambda q, u: u[1] ** 2 / 2, 2)
    solution = solve(
        problem, (ZERO, ZERO, ZERO), (ONE, ZERO, ONE), 1.0, method=Midpoint(Exponential(space)), steps=steps
    )
    reach = np.stack([h * h * (steps - 0.5 - np.arange(steps)), np.full(steps, h)])
    assert solution.success
    assert norm(solution.controls[:, 0] - np.linalg.pinv(reach) @ np.array([1.0, 0.0])) < 1e-8
    assert norm(solution.controls[:, 1] - 1) < 1e-12
    assert norm(solution.costates[:2]) < 1e-12


@pytest.mark.slow
def test_the_ends_of_an_integrated_trajectory_on_the_sphere_lead_back_to_it():
    """The integrator's own trajectory, from where it starts to where it ends: the costates are found, and all nodes."""
    from tests.integrators.singular.test_rattle import LIFT, PROBLEM, RATTLE, start

    z, steps = start(), 6
    path = integrate(PROBLEM, RATTLE, z, 0.1, steps)
    options = {"classification": classify(PROBLEM), "integrator": RATTLE}
    solution = solve(
        PROBLEM, np.asarray(path.q[0]), np.asarray(path.q[-1]), 0.6, method=LIFT.discretization, steps=steps, **options
    )
    assert norm(solution.states - path.q) < 1e-10
    assert norm(solution.costates - path.p) < 1e-10
    assert norm(solution.controls - path.controls) < 1e-9
    assert solution.singular.independent == 2  # of four: the two on the state at either end repeat each other on P_f
    beside = solve(
        PROBLEM, path.q[0], np.array([1.0, 0, 0]), 0.6, method=LIFT.discretization, steps=steps, throw=False, **options
    )
    # Another end contradicts the start, and the iteration sees it.
    assert beside.result == Result[Result.no_improvement]
    assert beside.statistics.iterations < 60


@pytest.mark.slow
def test_a_reduction_gives_the_same_extremal_with_its_controls_at_the_stages():
    """For Aly and Chan's problem both methods are the midpoint rule, and the control is the state."""
    c = classified(ALY_CHAN)
    options = {"classification": c, "integrator": singular_integrator(c, MIDPOINT, "reduced")[0]}
    solution, other = (
        solve(ALY_CHAN, (ZERO, None), (ONE, None), np.pi / 2, method=MIDPOINT, steps=8, **options),
        aly_chan(8),
    )
    assert solution.singular.strategy == "ReducedIntegrator, as given"
    for name in ("states", "costates", "controls", "cost", "hamiltonians"):
        for a, b in zip(jax.tree.leaves(getattr(solution, name)), jax.tree.leaves(getattr(other, name)), strict=True):
            assert norm(a - b) < 1e-13, name


@pytest.mark.slow
def test_constraints_at_the_stages_lead_from_end_to_end_of_an_integrated_trajectory():
    problem = SINGULAR["massless particle"]().problem
    c, discretization = classified(problem), Midpoint(Exponential(problem.manifold))
    method, _ = singular_integrator(c, discretization, "stage")
    path = integrate(problem, method, c.manifold.nearby((np.array([0.3, 0.2]), np.array([-0.1, 0.15]))), 0.1, 6)
    options = {"classification": c, "integrator": method}
    solution = solve(
        problem, np.asarray(path.q[0]), np.asarray(path.q[-1]), 0.6, method=discretization, steps=6, **options
    )
    for found, integrated in (
        (solution.states, path.q),
        (solution.costates, path.p),
        (solution.controls, path.controls),
    ):
        assert norm(found - integrated) < 1e-12
    assert solution.singular.independent == 2  # P_f has no room for the other two


@pytest.mark.slow
def test_a_rigid_body_with_a_cost_free_torque_is_turned():
    """Rates free at both ends. ``int |w|^2`` is at least the square of the angle; a constant rate, held by torques,
    costs more.

    The spatial angular costate is a momentum of the symmetry of the problem, and kept; on ``P_f`` ``p_w3 = 0`` repeats
    a condition at either end.
    """
    problem, vector, steps = SINGULAR["free actuator"]().problem, np.array([0.4, -0.3, 0.5]), 8
    discretization = Midpoint(Cayley(problem.manifold))
    solution = solve(problem, (np.eye(3), None), (rotation(vector), None), 1.0, method=discretization, steps=steps)
    arc, torque = solution.singular, np.cross(vector, INERTIA * vector)
    assert solution.success
    assert (arc.dimension, arc.kernel, arc.gauge_controls, arc.independent) == (10, 0, 0, 10)
    assert arc.strategy.startswith("rattle: ")
    assert arc.presymplectic
    assert "strict generalised Legendre-Clebsch condition met" in arc.second_order
    assert vector @ vector < solution.cost < vector @ vector + torque[:2] @ torque[:2] / 2
    assert max(solution.checks.defect, solution.checks.stationarity) < 1e-13
    assert norm(solution.states[0][-1] - rotation(vector)) < 1e-12
    assert norm(solution.costates[1][[0, -1]]) < 1e-12
    assert norm(solution.costates[1][:, 2]) < 1e-12  # phi = p_w3 / J_3
    (momentum,) = solution.spatial_costates.values()
    assert np.max(np.ptp(momentum, axis=0)) < 1e-13
    assert solution.checks.hamiltonian_spread < 1e-4


def test_an_integrator_is_for_singular_problems_and_their_discretization():
    regular = OptimalControlProblem(LINE, lambda q, u: u, lambda q, u: u @ u / 2, 1)
    rattle = RattleIntegrator(CotangentLift(MIDPOINT), (0,))
    with pytest.raises(InvalidInputError, match="the problem is regular"):
        solve(regular, ZERO, ONE, 1.0, method=Midpoint(Exponential(LINE)), steps=4, integrator=rattle)
    options = {"classification": classified(ALY_CHAN), "integrator": rattle}
    with pytest.raises(InvalidInputError, match="by the same discretization"):
        solve(ALY_CHAN, (ZERO, None), (ONE, None), 1.0, method=Theta(Exponential(PLANE), 0.0), steps=4, **options)
    with pytest.raises(InvalidInputError, match="one stage a step"):
        solve(
            ALY_CHAN,
            (ZERO, None),
            (ONE, None),
            1.0,
            method=MIDPOINT,
            steps=4,
            **options | {"integrator": Composition(rattle)},
        )
    with pytest.raises(InvalidInputError, match="classification must be that of the problem"):
        solve(regular, ZERO, ONE, 1.0, method=Midpoint(Exponential(LINE)), steps=4, classification=classified(ALY_CHAN))


@pytest.mark.slow
def test_an_extremal_that_is_a_point_rests():
    """``x' = u`` with cost ``x^2``: ``P_f = {x = p = 0}``."""
    problem, options = OptimalControlProblem(LINE, lambda q, u: u, lambda q, u: q @ q, 1), {"horizon": 1.0, "steps": 4}
    solution = solve(problem, start=ZERO, end=None, method=Midpoint(Exponential(LINE)), **options)
    assert solution.success
    assert norm((solution.states, solution.costates, solution.controls)) < 1e-15
    assert (solution.singular.dimension, solution.singular.independent) == (0, 0)
    with pytest.raises(InvalidInputError, match=r"secondary equation = 0\.5 \(relative\)"):
        solve(problem, start=ONE, end=None, method=Midpoint(Exponential(LINE)), **options)


@pytest.mark.slow
def test_an_iterate_that_overflows_leaves_no_warning():
    """``log(cosh(100 u))`` is infinite from ``u = 8`` on, and flat before that."""
    plane = Euclidean(2)
    problem = OptimalControlProblem(
        plane, lambda q, u: jnp.stack([q[1], u[0]]), lambda q, u: jnp.log(jnp.cosh(100 * u[0])), 1
    )
    ends = np.zeros(2), np.array([1.0, 0.0])
    assert not solve(problem, *ends, 1.0, method=Midpoint(Exponential(plane)), steps=6, throw=False).success
