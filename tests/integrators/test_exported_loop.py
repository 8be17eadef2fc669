"""A closed loop of an exported solver: noise, another plant, and targets that change; every solve is judged."""

import time
from collections import Counter
from typing import Any, NamedTuple

import numpy as np
import pytest
from retrax.integrators import Guess, OptimalControlProblem, Solver
from retrax.retractions import Cayley, Midpoint
from scipy.spatial.transform import Rotation

from tests.integrators.problems import IDENTITY, REST, RIGID, SLEW_END, SPACECRAFT, half_square, spacecraft
from tests.support.exported import STATUSES, Flown, objects_of_core

LIMIT, HORIZON, STEPS = 10.0, 90.0, 20  # N m, s
SAMPLE, TARGET = 1.5, 60  # s; samples between targets
PLANT = SPACECRAFT * np.array([1.05, 0.97, 1.03])
NOISE, RATE_NOISE, DISTURBANCE = 1e-4, 1e-5, 0.3  # rad, rad/s, N m: standard deviations
SOLVES = 10_000
CHECKED = 500  # solves from one that the engine in Python judges too to the next


def moved(attitude: np.ndarray, rate: np.ndarray, torque: np.ndarray, push: np.ndarray) -> tuple[Any, Any]:
    """The state of the plant after a sample, by small steps of the fourth order in the rate."""

    def slope(w: np.ndarray) -> np.ndarray:
        return (torque + push - np.cross(w, PLANT * w)) / PLANT

    h = SAMPLE / 6
    for _ in range(6):
        a = slope(rate)
        b = slope(rate + h / 2 * a)
        c = slope(rate + h / 2 * b)
        middle, d = rate + h / 2 * b, slope(rate + h * c)
        rate = rate + h / 6 * (a + 2 * b + 2 * c + d)
        attitude = attitude @ Rotation.from_rotvec(h * middle).as_matrix()
    return attitude, rate


def cayley(vectors: np.ndarray) -> np.ndarray:
    """The rotations of vectors by the Cayley map: by twice the arc tangent of half their lengths."""
    lengths = np.linalg.norm(vectors, axis=1, keepdims=True)
    scale = np.divide(2 * np.arctan(lengths / 2), lengths, out=np.ones_like(lengths), where=lengths > 0)
    return Rotation.from_rotvec(scale * vectors).as_matrix()


def discrepancy(found: Any, given: Any) -> float:
    """How far a solution is from its ends, from the midpoint rule of the attitude and the rate, and beyond the limits.

    Relative to the sizes of the ends, of the rates along the trajectory, and of the limits.
    """
    attitudes, rates = found["states"][:, :9].reshape(-1, 3, 3), found["states"][:, 9:]
    torques, h = found["solution"]["controls"][:, 0], HORIZON / STEPS
    middle = (rates[:-1] + rates[1:]) / 2
    slopes = (torques - np.cross(middle, SPACECRAFT * middle)) / SPACECRAFT
    half = cayley(h / 2 * middle)
    size = np.abs(rates).max()
    return max(
        np.abs(found["states"][0] - given["start"]).max(),
        np.abs(found["states"][-1] - given["end"]).max(),
        np.abs(attitudes[1:] - attitudes[:-1] @ half @ half).max(),
        np.abs(rates[1:] - rates[:-1] - h * slopes).max() / size,
        (np.abs(torques).max() - LIMIT) / LIMIT,
    )


def judged(solver: Solver, found: Any, given: Any) -> float:
    """The relative difference from the cost of the solution that the solver in Python finds from this one."""

    def state(numbers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return numbers[..., :9].reshape(*numbers.shape[:-1], 3, 3), numbers[..., 9:]

    guess = Guess(state(found["solution"]["centres"]), found["solution"]["controls"][:, 0])
    solution = solver.solve(state(given["start"]), state(given["end"]), HORIZON, guess)
    return abs(solution.cost - found["cost"]) / solution.cost


class Flight(NamedTuple):
    """What a closed loop has done."""

    ends: Counter[str]  # of the solves
    iterations: list[int]
    seconds: list[float]
    discrepancies: list[float]
    costs: list[float]  # relative differences from Python


def flight(count: int, solver: Solver, flown: Flown) -> Flight:
    """A closed loop of so many samples, with another target after each ``TARGET`` of them."""
    rng, done = np.random.default_rng(0), Flight(Counter(), [], [], [], [])
    attitude, rate, torque, given = IDENTITY, REST, REST, flown.default.copy()
    for k in range(count):
        if k % TARGET == 0:
            given["end"] = np.r_[Rotation.random(random_state=k).as_matrix().ravel(), REST]
        seen = attitude @ Rotation.from_rotvec(NOISE * rng.normal(size=3)).as_matrix()
        given["start"] = np.r_[seen.ravel(), rate + RATE_NOISE * rng.normal(size=3)]
        began = time.perf_counter()
        found = flown.solve(given)
        done.seconds.append(time.perf_counter() - began)
        done.ends[STATUSES[found["status"]]] += 1
        done.iterations.append(int(found["iterations"]))
        if STATUSES[found["status"]] == "SOLVED":
            done.discrepancies.append(discrepancy(found, given))
            if k % CHECKED == 1:
                done.costs.append(judged(solver, found, given))
            given["guess"], torque = found["solution"], found["solution"]["controls"][0, 0]
        else:  # the torque stays for a sample
            given["guess"] = flown.default["guess"]
        attitude, rate = moved(attitude, rate, np.clip(torque, -LIMIT, LIMIT), DISTURBANCE * rng.normal(size=3))
    return done


@pytest.mark.slow
def test_a_closed_loop_never_fails_silently(tmp_path):
    """Each solve has success, or says that it has none; the torque of a success keeps the limits and the equations."""
    problem = OptimalControlProblem(RIGID, spacecraft, half_square, 3, control_bounds=(-LIMIT, LIMIT))
    solver = Solver(problem, Midpoint(Cayley(RIGID)), STEPS)
    first = solver.solve((IDENTITY, REST), (SLEW_END, REST), HORIZON)
    folder = solver.export_c(tmp_path / "slew", "slew", first)
    done = flight(
        SOLVES, solver, Flown(folder, "slew", objects_of_core(folder, tmp_path / "core", "-O2", "-fPIC"), "-O2")
    )
    assert sum(done.ends.values()) == SOLVES
    assert done.ends["SOLVED"] >= 0.99 * SOLVES
    assert max(done.iterations) <= 105
    assert max(done.discrepancies) <= 1e-7
    assert max(done.costs) <= 1e-7
