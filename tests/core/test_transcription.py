"""Linear systems and steps of trajectories by the core beside the discrete equations and their derivatives by JAX."""

from functools import cache
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from retrax.compute.binding.library import best_instruction_set
from retrax.compute.binding.search import Search, SearchStatus
from retrax.compute.binding.transcription import FunctionName, Scale, Trajectory, Transcription
from retrax.integrators import OptimalControlProblem, Solver
from retrax.integrators.boundary_value.transcription import core_transcription
from retrax.integrators.boundary_value.transcription.discrete_phase import DiscretePhase
from retrax.integrators.boundary_value.transcription.functions.collocation import CollocationFunctions
from retrax.integrators.boundary_value.transcription.iterate import CollocationUnknowns
from retrax.manifolds import Euclidean, InvalidInputError
from retrax.retractions import Addition, Gauss, Midpoint, default_retraction

from ..integrators.problems import SPHERE, half_square
from ..integrators.search_cases import SLEWS
from .core_calls import LimitScale, expand, measure, move, move_inequalities, step_inequalities
from .discrete_equations import DiscreteEquations, Expansion
from .trajectories import CASES, posed, put

SETS = range(best_instruction_set() + 1)
NAMES = list(CASES)
SHARE = 0.9  # of the way to the boundary that slacks may go
AWAY = 0.1  # size of the random steps from a solution, in units of the scaling


def compare(found: Trajectory, expected: dict[str, np.ndarray], rtol: float = 1e-9) -> None:
    """Equal arrays but for rounding, which is relative to the largest entry of each."""
    for name, array in expected.items():
        size = max(1.0, np.abs(array).max(initial=0.0))
        np.testing.assert_allclose(found[name], np.ravel(array), rtol=rtol, atol=1e-10 * size, err_msg=name)


@cache
def case(name: str) -> tuple[DiscretePhase, Any, DiscreteEquations]:
    """A transcribed problem, its guess, and its discrete equations."""
    solver, way, options = CASES[name]()
    with pytest.MonkeyPatch.context() as patch:
        phase, guess = posed(solver, way, patch, **options)
    return phase, guess, DiscreteEquations(phase)


def random_iterate(of: Transcription, phase: DiscretePhase, guess: Any, seed: int) -> Trajectory:
    """A trajectory random steps away from a solution, with random multipliers, slacks and excesses."""
    rng, search, to = np.random.default_rng(seed), Search(of, 1e-8, 100), of.trajectory()
    put(search.trajectory, phase, guess)
    search.run()
    at, sizes = search.trajectory, search.read().judging
    to.copy_from(at)
    at["STEPS"] = AWAY * np.tile(sizes.unknowns, len(at["STEP_SIZE"])) * rng.standard_normal(len(at["STEPS"]))
    speed = AWAY / at["STEP_SIZE"].sum() * np.tile(sizes.nodes, len(at["VELOCITY_STEPS"]) // len(sizes.nodes))
    at["VELOCITY_STEPS"] = speed * rng.standard_normal(len(speed))
    for name in ("COVECTOR_STEPS", "POINT_MULTIPLIER_STEPS"):
        at[name] = rng.standard_normal(len(at[name]))
    move(to, at, 1.0)
    elastic = rng.random(len(to["LIMITS"])) < 0.5
    for name in ("SLACKS", "LIMIT_MULTIPLIERS", "EXCESSES"):
        to[name] = (0.1 + rng.random(len(to[name]))) * (to["LIMIT_WEIGHTS"] > 0)
    to["EXCESSES"] = np.where(elastic, to["EXCESSES"], 0.0)
    to["PENALTIES"] = np.where(elastic, to["LIMIT_MULTIPLIERS"] + 0.5, np.inf)
    to["BARRIER"] = np.array([0.3])
    to.evaluate()
    return to


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.usual(2)
def test_systems_are_the_derivatives_of_the_discrete_equations(name):
    """At iterates some random steps from the guess; the cases share out the instruction sets."""
    phase, guess, equations = case(name)
    place = NAMES.index(name)
    of = core_transcription.make_transcription(phase, SETS[place % len(SETS)])
    at = random_iterate(of, phase, guess, place)
    expected = Expansion(equations, at)
    own, steps = expected.of_steps, equations.phase.transcription
    compare(at, {
        "NODES": expected.nodes, "DEFECTS": expected.defects, "NODE_FRAMES": expected.frames,
        "MULTIPLIERS": expected.multipliers, "NODE_COSTATES": expected.node_costates, "COSTS": own["cost"],
    })  # fmt: skip
    if not steps.inequalities:
        compare(at, without_barrier(expected.condensed(own["hessian"], own["slope"], np.zeros_like(own["slope"]))))
        return
    compare(at, {"LIMITS": expected.flat(own["limits"])})
    system = expected.condensed(*expected.with_inequalities(at))
    compare(at, system)
    barrier = at["BARRIER"][0]
    compare(at, {"NEWTON_SIDES": system["RIGHT_SIDES"] + barrier * system["BARRIER_SIDES"]})
    lacking = at["LIMITS"] + at["SLACKS"] - at["EXCESSES"]
    held = np.sum(at["LIMIT_WEIGHTS"] * at["LIMIT_MULTIPLIERS"] * lacking)
    measured = Scale(np.ones(len(at["PARTS"])), np.ones(equations.n), 1.0)
    limits = LimitScale(1.0, np.ones(steps.inequalities))
    measure(at, measured, measured, limits, 1.0)
    rest, asked, survey = at["PENALTIES"] - at["LIMIT_MULTIPLIERS"], at["LIMIT_WEIGHTS"] > 0, at["LIMIT_SURVEY"]
    np.testing.assert_allclose(survey[6], held, rtol=1e-9)
    elastic = asked & np.isfinite(rest)
    products = (at["LIMIT_MULTIPLIERS"] * at["SLACKS"])[asked], rest[elastic] * at["EXCESSES"][elastic]
    everywhere = np.concatenate(products)
    np.testing.assert_allclose(survey[2:4], [everywhere.max(), everywhere.min()], rtol=1e-9)


def without_barrier(system: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    return {name: array for name, array in system.items() if name != "BARRIER_SIDES"}


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.usual(2)
def test_steps_solve_the_linear_equations_and_move_in_charts(name):
    """A Newton step from the dense matrix of all unknowns: its condensed part gives the rest of it again."""
    phase, guess, equations = case(name)
    of = core_transcription.make_transcription(phase, SETS[-1])
    at = random_iterate(of, phase, guess, 50 + NAMES.index(name))
    expected, (count, n, s) = Expansion(equations, at), (equations.count, equations.n, equations.s)
    own, hessian, slope = expected.of_steps, expected.of_steps["hessian"], expected.of_steps["slope"]
    if phase.transcription.inequalities:
        hessian, plain, driven = expected.with_inequalities(at)
        slope = plain + at["BARRIER"][0] * driven
    matrix, side, unknowns = expected.kkt(hessian, slope)
    solution = np.linalg.solve(matrix, side)
    steps = solution[:unknowns].reshape(count, -1)
    of_nodes = solution[unknowns : unknowns + (count + 1) * n].reshape(count + 1, n)
    inner = slice(n, n + equations.inner)
    at["STEPS"] = np.delete(steps, np.r_[inner], axis=1).ravel()
    at["MULTIPLIER_STEPS"] = of_nodes.ravel()
    expand(at)
    if equations.collocates:
        of_points = solution[unknowns + (count + 1) * n :]
        compare(at, {"VELOCITY_STEPS": steps[:, inner], "POINT_MULTIPLIER_STEPS": of_points}, rtol=1e-6)
    part, to = 0.7, put(of.trajectory(), phase, guess)
    move(to, at, part)
    x, nu, u = equations._moved_all(expected.given, part * steps)
    moved = {"CENTRES": x, "CONTROLS": u}
    lift = expected.multipliers + part * at["COVECTOR_STEPS"].reshape(count + 1, n)
    costates = np.einsum("kne,kn->ke", expected.frames, lift)
    moved["COSTATES"] = costates + expected.paid
    if equations.collocates:
        lambdas = (expected.given["lambda"] + part * of_points.reshape(count, -1)).reshape(count, s, n)
        moved |= {"VELOCITIES": nu, "POINT_COSTATES": np.einsum("ksne,ksn->kse", expected.point_frames, lambdas)}
    compare(to, moved, rtol=1e-6)
    if phase.transcription.inequalities:
        check_inequalities(at, to, expected.flat(np.einsum("kci,ki->kc", own["limits by"], steps)))


def check_inequalities(at: Trajectory, to: Trajectory, change: np.ndarray) -> None:
    """Steps of slacks, multipliers and excesses solve their linear equations, and are made as far as they stay
    inside."""
    step_inequalities(at, SHARE)
    s, nu, t, rho, mu = (at[k] for k in ("SLACKS", "LIMIT_MULTIPLIERS", "EXCESSES", "PENALTIES", "BARRIER"))
    ds, dnu, dt = (at[k] for k in ("SLACK_STEPS", "LIMIT_MULTIPLIER_STEPS", "EXCESS_STEPS"))
    asked, elastic = at["LIMIT_WEIGHTS"] > 0, np.isfinite(rho)
    zeta = np.where(elastic, rho, 0.0) - nu
    size = 1 + np.abs(change) + np.abs(ds) + np.abs(dt)
    lacking = at["LIMITS"] + s - t
    assert np.all(np.abs(lacking + change + ds - dt)[asked] <= 1e-6 * size[asked])
    assert np.all(np.abs(nu * s - mu + nu * ds + s * dnu)[asked] <= 1e-6 * (size * (1 + np.abs(dnu)))[asked])
    both = asked & elastic
    assert np.all(np.abs(zeta * t - mu + zeta * dt - t * dnu)[both] <= 1e-6 * (size * (1 + np.abs(dnu)))[both])
    assert not np.any(dt[~elastic])

    def most(value: np.ndarray, step: np.ndarray) -> float:
        """The part of a step that goes a share of the way to zero at most."""
        falls = step < 0
        return min(1.0, np.min(-SHARE * value[falls] / step[falls], initial=1.0))

    primal = min(most(s[asked], ds[asked]), most(t[both], dt[both]))
    dual = min(most(nu[asked], dnu[asked]), most(zeta[both], -dnu[both]))
    w = at["LIMIT_WEIGHTS"]
    potential = np.where(both, np.where(both, rho, 0.0) * dt - mu * dt / np.where(both, t, 1.0), 0.0)
    ahead = np.sum((w * (potential - mu * ds / np.where(asked, s, 1.0)))[asked])
    found = at["LIMIT_STEP"]
    np.testing.assert_allclose([min(1.0, found[0]), found[1]], [primal, dual], rtol=1e-6)
    np.testing.assert_allclose(found[2:4], [ahead, np.sum(w * dnu * lacking)], rtol=1e-6, atol=1e-8)
    move_inequalities(to, at, 0.5, 0.25)
    expected = {"SLACKS": s + 0.5 * ds, "EXCESSES": t + 0.5 * dt, "LIMIT_MULTIPLIERS": nu + 0.25 * dnu}
    for name, array in expected.items():
        inside = asked & (array > 1e-3)  # else multipliers are held near the barrier over their slacks
        np.testing.assert_allclose(to[name][inside], array[inside], rtol=1e-6)


@pytest.mark.parametrize("angle", [0.1, 0.9, 1.0, 1.5, 2.0])
@pytest.mark.usual(1)
def test_ends_that_are_far_apart_meet_along_the_arc_between_them(angle, monkeypatch):
    """Two steps at rest on a sphere whose ends lie apart by an angle: where their chord is short, the defect is its
    tangential part at the end of the first step; else the node lies amid them, and the defect is the arc."""
    problem = OptimalControlProblem(SPHERE, lambda q, u: u - (u @ q) * q, half_square, 3)
    way = np.array([0.0, 0.0, 1.0]), np.array([np.sin(0.3), 0.0, np.cos(0.3)]), 1.0
    phase, guess = posed(Solver(problem, Midpoint(default_retraction(SPHERE)), 2), way, monkeypatch)
    at = put(core_transcription.make_transcription(phase).trajectory(), phase, guess)
    centres = np.array([[0.0, 0.0, 1.0], [np.sin(angle), 0.0, np.cos(angle)]])
    at["CENTRES"], at["CONTROLS"] = centres.ravel(), 0.0
    at.evaluate()
    sizes = [np.linalg.norm(at[name].reshape(3, 2)[1]) for name in ("DEFECTS", "ASKED")]
    node = at["NODES"].reshape(3, 3)[1]
    if np.abs(centres[1] - centres[0]).max() < 0.9:  # of the largest entry of a node
        np.testing.assert_allclose(sizes, np.sin(angle), rtol=1e-12)
        np.testing.assert_allclose(node, centres[0], atol=1e-14)
    else:
        np.testing.assert_allclose(node, [np.sin(angle / 2), 0, np.cos(angle / 2)], atol=1e-2)
        np.testing.assert_allclose(sizes, [angle, angle * np.cos(angle / 2)], rtol=1e-2)


@pytest.mark.parametrize("power", [-9, -3, 2, 9])
@pytest.mark.usual(1)
def test_natural_sizes_change_with_the_units_of_the_problem(power, monkeypatch):
    """A cart in another unit of length: its states and controls have sizes in that unit, its cost is the same."""
    plane, found = Euclidean(2), []
    for unit in (1.0, 10.0**power):
        problem = OptimalControlProblem(
            plane, lambda q, u: jnp.stack([q[1], u[0]]), lambda q, u, unit=unit: u @ u / (2 * unit**2), 1
        )
        way = np.zeros(2), np.array([unit, 0.0]), 2.0
        phase, guess = posed(Solver(problem, Midpoint(Addition(plane)), 8), way, monkeypatch)
        search = Search(core_transcription.make_transcription(phase), 1e-9, 100)
        put(search.trajectory, phase, guess)
        assert search.run() is SearchStatus.CONVERGED
        found.append(search.read().judging.copy)
    one, other = found
    np.testing.assert_allclose(other.unknowns, one.unknowns * 10.0**power, rtol=1e-9)
    np.testing.assert_allclose(other.nodes, one.nodes * 10.0**power, rtol=1e-9)
    assert other.cost == pytest.approx(one.cost, rel=1e-9)


def test_what_does_not_fit_is_refused(monkeypatch):
    phase, _ = posed(CASES["a slew"]()[0], SLEWS, monkeypatch)
    right = core_transcription.make_transcription(phase, 0)
    programs, (name, sizes) = dict(right.programs), (FunctionName, right.sizes)
    none = np.zeros(0)
    tableau, columns = (np.ones((1, 1)), np.ones(1)), (np.zeros(sizes.state_numbers, np.intp),) * 2
    for wrong, words in (
        (sizes._replace(steps=0), "expected sizes of at most 1024"),
        (sizes._replace(steps=1 << 40), "expected sizes of at most 1024"),
        (sizes._replace(state_size=7), "expected"),
        (sizes._replace(inequalities=2), "expected"),
    ):
        with pytest.raises(InvalidInputError, match=words):
            Transcription(wrong, tableau, columns, None, np.zeros(wrong.limits), 0, programs)
    with pytest.raises(InvalidInputError, match="needs the function POINTS"):
        Transcription(
            sizes, tableau, columns, None, none, 0, {k: p for k, p in programs.items() if k is not name.POINTS}
        )
    with pytest.raises(InvalidInputError, match="columns of entries"):
        Transcription(sizes, tableau, (columns[0] - 1, columns[1]), None, none, 0, programs)
    with pytest.raises(InvalidInputError, match="weights of a tableau"):
        Transcription(sizes, (np.ones((1, 1)), np.ones(2)), columns, None, none, 0, programs)


@pytest.mark.parametrize("name", NAMES)
def test_searches_end_where_the_first_and_second_order_conditions_hold(name):
    """The discrete equations are evaluated at the end of the search: defects, slopes, complementarity, and the
    curvature on the null space of the constraints."""
    phase, guess, equations = case(name)
    search = Search(core_transcription.make_transcription(phase, SETS[-1]), 1e-10, 100)
    put(search.trajectory, phase, guess._replace(slacks=None))
    assert search.run() is SearchStatus.CONVERGED
    found, at = search.read(), search.trajectory
    assert found.facts.converged
    assert found.facts.strict
    expected, steps = Expansion(equations, at), phase.transcription
    own, hessian = expected.of_steps, expected.of_steps["hessian"]
    size = sizes_of_unknowns(equations, found.judging)
    assert np.abs(expected.defects / found.judging.nodes).max() < 1e-8
    parts = np.abs(own["gradient"]) + np.einsum("kn,knz->kz", *map(np.abs, (expected.multipliers[1:], expected.right)))
    parts += np.einsum("kn,knz->kz", *map(np.abs, (expected.multipliers[:-1], expected.left)))
    assert np.abs(own["slope"] * size).max() < 1e-7 * np.max(parts * size)
    if steps.inequalities:
        w, nu, limits = expected.given["weights"], expected.given["nu_limits"], own["limits"]
        assert np.max(np.where(w > 0, limits, 0.0)) < 1e-7 * max(np.abs(limits).max(), 1.0)
        assert np.min(nu) >= 0
        assert np.sum(w * nu * np.abs(limits)) < 1e-6 * at["TOTALS"][0]
        hessian = expected.with_inequalities(at)[0]
    matrix, _, unknowns = expected.kkt(hessian, own["slope"])
    every = np.tile(size, equations.count)
    rows = matrix[unknowns:, :unknowns] * every
    largest = np.abs(rows).max(axis=1, keepdims=True)
    rows = rows[largest[:, 0] > 0] / largest[largest > 0][:, None]
    _, singular, basis = np.linalg.svd(rows)
    null = basis[np.sum(singular > 1e-12 * singular[0]) :].T
    if null.shape[1]:
        reduced = null.T @ (matrix[:unknowns, :unknowns] * np.outer(every, every)) @ null
        assert np.linalg.eigvalsh(reduced)[0] > 0


def sizes_of_unknowns(equations: DiscreteEquations, scale: Scale) -> np.ndarray:
    """Scaling factors of all unknowns of a step."""
    velocities = np.tile(scale.nodes, equations.s if equations.collocates else 0)
    return np.concatenate([scale.unknowns[: equations.n], velocities, scale.unknowns[equations.n :]])


@pytest.mark.parametrize("name", NAMES)
def test_what_the_memory_of_a_search_held_before_changes_no_bit(name):
    phase, guess, _ = case(name)
    own, ends = core_transcription.make_transcription(phase, SETS[-1]), []
    for held in (0.0, np.nan, 1e300):
        Search(own, 1e-10, 100)
        own.search_room(1)[...] = held
        search = Search(own, 1e-10, 100)
        put(search.trajectory, phase, guess._replace(slacks=None))
        status, found = search.run(), search.read()
        told = [status, found.facts, found.limits.tobytes()]
        names = "CENTRES", "CONTROLS", "COSTATES", "LIMIT_MULTIPLIERS", "RESIDUALS", "STEPS", "TOTALS"
        ends.append(told + [found.trajectory[array].tobytes() for array in names])
    assert ends[0] == ends[1] == ends[2]


def test_the_first_centre_of_a_step_is_in_the_middle_of_an_even_number_of_points(monkeypatch):
    """On a sphere it is nearly as far from either of the two middle states."""
    begin, begun = CollocationFunctions.begin, []

    def begin_and_keep(self: CollocationFunctions, states: np.ndarray, *others: Any) -> CollocationUnknowns:
        begun.append((states, begin(self, states, *others)))
        return begun[-1][1]

    monkeypatch.setattr(CollocationFunctions, "begin", begin_and_keep)
    problem = OptimalControlProblem(SPHERE, lambda q, u: jnp.cross(u, q), half_square, 3)
    Solver(problem, Gauss(2, default_retraction(SPHERE)), 4).solve(np.eye(3)[0], np.eye(3)[1], 1.0)
    states, unknowns = begun[0]
    before, after = np.linalg.norm(states - unknowns.centres[:, :, None], axis=-1).swapaxes(0, 2)
    assert before.min() > 1e-2
    np.testing.assert_allclose(before, after, rtol=0.05)
