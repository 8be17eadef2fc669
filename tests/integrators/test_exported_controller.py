"""Exported receding horizon controllers: the closed loop of the compiled controller is that of the controller in
Python."""

from collections import Counter
from copy import copy
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import retrax as rx
from retrax.compute.binding import transcription
from retrax.integrators.closed_loop.plant import Plant, Signal
from retrax.manifolds import InvalidInputError
from scipy.spatial.transform import Rotation

from tests.support import satellite
from tests.support.exported import STATUSES, FlownController, built_and_tested, compile_loop_of_the_page

S2, BODY = rx.Sphere(2), rx.SO(3) * rx.Euclidean(3)
NORTH, EAST, REST = np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0]), np.zeros(3)
INERTIA, TORQUE = np.array([3.0, 2.0, 1.5]), 0.6
TIMES = np.linspace(0, 4, 41)
PATH = np.stack([np.cos(0.8 * TIMES), np.sin(0.8 * TIMES), 0 * TIMES], axis=1)


class Loop(NamedTuple):
    """A controller, its plant and the start, and how often and how long it runs."""

    controller: rx.RecedingHorizon
    plant: rx.OptimalControlProblem
    start: Any
    sample: float
    horizon: float
    options: dict[str, Any]


@pytest.fixture(autouse=True)
def _searches_of_the_core(monkeypatch):
    """Searches with the instruction set of the program, which rounds products and sums twice."""
    monkeypatch.setattr(transcription, "best_instruction_set", lambda: 0)


def turning(**options):
    """A problem of a direction that turns."""
    return rx.OptimalControlProblem(S2, lambda q, u: jnp.cross(u, q), lambda q, u: u @ u / 2, 3, **options)


def body(q, u):
    """A rigid body."""
    return q[0] @ rx.hat(q[1]), (u - jnp.cross(q[1], INERTIA * q[1])) / INERTIA


def wandering(q, t, rng):
    """A measured direction."""
    seen = q + 1e-3 * rng.normal(size=3)
    return seen / np.linalg.norm(seen)


def loops() -> dict[str, Any]:
    """The loops by their names."""
    retraction = rx.default_retraction(S2)
    follow = rx.tracking(turning(), (TIMES, PATH), weights=5.0, control_weights=0.01)
    limited = rx.OptimalControlProblem(
        BODY,
        body,
        lambda q, u: u @ u / 2,
        3,
        control_bounds=(-TORQUE, TORQUE),
        constraints={"rate": lambda q, u: q[1] @ q[1] / 0.5**2 - 1},
    )
    end = np.asarray(jax.scipy.linalg.expm(rx.hat(jnp.array([0.5, 1.0, -0.8])))), REST
    noisy = {"measure": wandering}
    return {
        "a moving target on a sphere": lambda: Loop(
            rx.RecedingHorizon(rx.Solver(follow, rx.Gauss(2, retraction), steps=10), None, horizon=1.0, hold=0.1),
            turning(), NORTH, 0.1, 2.0, noisy),
        "a fixed end on a sphere, by the midpoint rule": lambda: Loop(
            rx.RecedingHorizon(rx.Solver(turning(control_bounds=(-1.2, 1.2)), rx.Midpoint(retraction), steps=12), EAST,
                               horizon=0.8, end_time=2.0, hold=0.1, max_iterations=4),
            turning(), NORTH, 0.1, 2.0, noisy),
        "a rigid body with limits and few iterations": lambda: Loop(
            rx.RecedingHorizon(rx.Solver(limited, rx.Gauss(3, rx.Cayley(BODY)), steps=8), end, end_time=8.0,
                               max_iterations=2, hold=0.4),
            limited, (np.eye(3), REST), 0.4, 7.2, {}),
    }  # fmt: skip


def flat(q: Any) -> np.ndarray:
    """The entries of a state."""
    return np.concatenate([np.ravel(part) for part in jax.tree.leaves(q)])


def both(loop: Loop, folder: Any, core: Any, *options: str) -> tuple[Any, Any, FlownController]:
    """The closed loops with the controller in Python and with the compiled one."""
    flown = FlownController(loop.controller.export_c(folder, "own", loop.start), "own", core, *options)

    def fly(q: Any, t: float) -> np.ndarray:
        return flown(flat(q), t)

    given = loop.plant, loop.start, loop.horizon, loop.sample
    python, c = (rx.simulate(given[0], own, *given[1:], **loop.options) for own in (loop.controller, fly))
    return python, c, flown


def agrees(python: Any, c: Any, flown: FlownController) -> None:
    """Both loops have the same states, controls, sources and iterations."""
    size = max(1.0, np.abs(python.u).max())
    assert np.abs(python.u - c.u).max() <= 1e-9 * size
    for own, other in zip(jax.tree.leaves(python.q), jax.tree.leaves(c.q), strict=True):
        assert np.abs(own - other).max() <= 1e-9 * max(1.0, np.abs(own).max())
    assert list(python.solves.sources) == flown.sources
    assert python.solves.iterations.tolist() == flown.iterations


@pytest.mark.parametrize("name", loops())
@pytest.mark.slow
def test_the_compiled_controller_flies_the_loop_of_python(name, tmp_path, core):
    loop = loops()[name]()
    agrees(*both(loop, tmp_path / "own", core, "-O1"))


@pytest.fixture(scope="module")
def pointing(tmp_path_factory, core):
    """The loop of a moving target, and the folder of its controller."""
    loop = loops()["a fixed end on a sphere, by the midpoint rule"]()
    return loop, loop.controller.export_c(tmp_path_factory.mktemp("own") / "own", "pilot", loop.start)


def test_a_failure_is_said_and_the_control_of_the_plan_stays(pointing, core):
    loop, folder = pointing
    flown = FlownController(folder, "pilot", core, "-O1")
    lost = flown(np.full(3, np.nan), 0.0)
    assert flown.sources == ["none"]
    assert not lost.any()
    first = flown(loop.start, 0.1)
    again = flown(np.full(3, np.nan), 0.2)
    assert STATUSES[flown.found["status"]] == "BAD_INPUT"
    assert flown.sources[1:] == ["solve", "plan"]
    python = copy(loop.controller)
    python._begin()
    assert np.abs(first - python(loop.start, 0.1)).max() <= 1e-9
    assert np.abs(again - python.plan(0.15).controls).max() <= 1e-9
    flown(python.plan(0.2).states, 0.3)
    assert flown.sources[-1] == "solve"
    flown(loop.start, 2.5)  # out of reach, and nothing is left of the plan
    assert flown.sources[-1] == "plan"
    assert STATUSES[flown.found["status"]] in ("ITERATION_LIMIT", "INFEASIBLE")
    for k in range(4):
        flown(np.array([np.cos(0.5), 0.0, np.sin(0.5)]), 2.6 + 0.1 * k)
    assert flown.sources[-1] == "solve"


def test_the_control_loop_of_the_page_compiles(tmp_path, pointing):
    compile_loop_of_the_page("pilot_controller.h", pointing[1], tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("compiler", ["gcc", "clang"])
def test_a_controller_builds_and_passes_its_tests_without_warnings(compiler, tmp_path, pointing):
    said = built_and_tested(pointing[1], tmp_path, compiler)
    assert "status 0 after" in said
    assert "source 0 after" in said


def test_a_controller_says_what_it_cannot_export(tmp_path):
    retraction = rx.default_retraction(S2)
    bare = rx.Solver(turning(), rx.Midpoint(retraction), steps=6)
    walled = rx.Solver(turning(node_constraints={"wall": lambda q: q[0] - 0.9}), rx.Midpoint(retraction), steps=6)
    for solver, options, words in (
        (bare, {"delay": 0.1}, "a delay"),
        (bare, {"milliseconds": 5.0}, "max_iterations"),
        (walled, {}, "as constraints"),
    ):
        controller = rx.RecedingHorizon(solver, EAST, horizon=1.0, **options)
        with pytest.raises(InvalidInputError, match=words):
            controller.export_c(tmp_path / "own", "own", NORTH)
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_the_compiled_controller_of_a_satellite_flies_the_loop_of_python(tmp_path, core):
    options = {"parameters": satellite.ripple, "measure": satellite.measure}
    loop = Loop(satellite.controller(), satellite.plant(), satellite.START, satellite.SAMPLE, 3.0, options)
    agrees(*both(loop, tmp_path / "own", core, "-O1"))


class Flight(NamedTuple):
    """What a long closed loop of the compiled satellite has done."""

    flown: FlownController
    statuses: Counter[str]
    discrepancies: list[float]  # of plans that are solutions, from the equations of motion
    controls: np.ndarray
    rates: np.ndarray  # of the plant
    cones: np.ndarray


TARGET, SUBSTEPS = 400, 8  # samples with one target; of a judge in a step


def discrepancy(found: Any) -> float:
    """How far a plan is from the equations of motion, by Runge-Kutta steps from each node along its controls."""
    R, w, h = (found["states"][:, part].reshape(13, *shape) for part, shape in STATE)
    own, controls = np.diff(found["times"]), found["solution"]["controls"][..., :4]
    R0, w0, h0, dt = R[:-1], w[:-1], h[:-1], own[:, None] / SUBSTEPS
    places = (1 - 1 / np.sqrt(3)) / 2, (1 + 1 / np.sqrt(3)) / 2

    def slope(place, R, w, h):
        share = (place - places[0]) / (places[1] - places[0])
        u = (1 - share) * controls[:, 0] + share * controls[:, 1]
        spin = np.cross(w, satellite.J * w + h @ satellite.AXES.T)
        return R @ hats(w), (-u @ satellite.AXES.T - spin) / satellite.J, u

    def moved(slopes, step):
        return R0 + step[..., None] * slopes[0], w0 + step * slopes[1], h0 + step * slopes[2]

    for i in range(SUBSTEPS):
        a = slope(i / SUBSTEPS, R0, w0, h0)
        b = slope((i + 0.5) / SUBSTEPS, *moved(a, dt / 2))
        c = slope((i + 0.5) / SUBSTEPS, *moved(b, dt / 2))
        d = slope((i + 1) / SUBSTEPS, *moved(c, dt))
        R0, w0, h0 = moved([(p + 2 * q + 2 * r + s) / 6 for p, q, r, s in zip(a, b, c, d, strict=True)], dt)
    ends = zip((R0, w0, h0), (R[1:], w[1:], h[1:]), (1.0, satellite.RATE, 10.0), strict=True)
    return max(np.abs(own - other).max() / size for own, other, size in ends)


STATE = (slice(0, 9), (3, 3)), (slice(9, 12), (3,)), (slice(12, 16), (4,))


def hats(w: np.ndarray) -> np.ndarray:
    """The skew matrices of vectors."""
    return np.cross(w[:, None], np.eye(3)).mT


def flight(count: int, flown: FlownController) -> Flight:
    """A closed loop of so many samples, with another target after each ``TARGET`` of them."""
    arrays = (np.zeros((count, n)) for n in (4, 3, 1))
    rng, done = np.random.default_rng(3), Flight(flown, Counter(), [], *arrays)
    own, q = Plant(satellite.plant()), satellite.START
    for k in range(count):
        if k and k % TARGET == 0:
            flown.given["parameters"] = new_target(k).ravel()
        t = k * satellite.SAMPLE
        seen = satellite.measure(q, t, rng)
        u = flown(flat(seen), t)
        done.statuses[STATUSES[flown.found["status"]]] += 1
        if flown.sources[-1] == "solve":
            done.discrepancies.append(discrepancy(flown.found))
        q = own.advance(q, Signal.constant(u), 0.0, satellite.SAMPLE, satellite.ripple(t, rng))
        done.controls[k], done.rates[k], done.cones[k] = u, q[1], np.arccos(q[0] @ satellite.CAMERA @ satellite.SUN)
    return done


def new_target(seed: int) -> np.ndarray:
    """A random attitude whose camera is well away from the Sun."""
    for attempt in range(100):
        target = Rotation.random(random_state=1000 * seed + attempt).as_matrix()
        if np.arccos(target @ satellite.CAMERA @ satellite.SUN) > 1.3 * satellite.CONE:
            return target
    raise AssertionError("no attitude is away from the Sun")


@pytest.mark.slow
def test_a_long_loop_of_a_satellite_never_fails_silently(tmp_path, core):
    """Each solve has success, or says that it has none; all controls keep their bounds."""
    controller = satellite.controller(max_iterations=20)
    flown = FlownController(controller.export_c(tmp_path / "own", "own", satellite.START), "own", core, "-O2")
    done = flight(800, flown)
    assert done.statuses["SOLVED"] == flown.sources.count("solve")
    assert done.statuses["SOLVED"] >= 0.98 * 800
    assert max(done.discrepancies) <= 1e-3
    assert np.abs(done.controls).max() <= satellite.TORQUE
    assert np.linalg.norm(done.rates, axis=1).max() <= 1.1 * satellite.RATE
    assert max(flown.iterations[1:]) <= 20
