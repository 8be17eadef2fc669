"""Solves of many kinds: methods, meshes, limits, free ends, parameters."""

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np
from retrax.compute.binding.transcription import Trajectory
from retrax.integrators import Free, OptimalControlProblem, Solver
from retrax.integrators.boundary_value.transcription import core_transcription
from retrax.integrators.boundary_value.transcription.discrete_phase import DiscretePhase
from retrax.integrators.boundary_value.transcription.transcribed_problem import Transcription
from retrax.manifolds import Euclidean
from retrax.retractions import Addition, Cayley, Gauss, Midpoint, Theta, default_retraction

from ..integrators.problems import IDENTITY, REST, RIGID, SLEW, SLEW_END, SPHERE, half_square, spacecraft

LINE, PLANE = Euclidean(1), Euclidean(2)
SLEWS = (IDENTITY, REST), (SLEW_END, REST), 60.0
PARTICLE = (lambda q, u: jnp.stack([q[1], u[0]]), half_square, 1)
NORTH, EAST = np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0])


def sphere_problem() -> OptimalControlProblem:
    """A turn of a direction, whose functions have parameters."""
    return OptimalControlProblem(SPHERE, lambda q, u, k: k * jnp.cross(u, q), lambda q, u, k: u @ u / 2 + q[2], 3)


def pendulum(q: Any, u: Any) -> Any:
    """A pendulum with a torque."""
    return jnp.array([q[1], u[0] - jnp.sin(q[0])])


def obstacle(q: Any, u: Any) -> Any:
    """A disk beside the straight line between the ends."""
    return 0.04 - jnp.sum((q - jnp.array([0.5, 0.05])) ** 2)


CASES: dict[str, Callable[[], tuple[Solver, tuple, dict[str, Any]]]] = {
    "a slew": lambda: (Solver(SLEW, Midpoint(Cayley(RIGID)), 30), SLEWS, {}),
    "one step": lambda: (
        Solver(OptimalControlProblem(LINE, lambda q, u: u, half_square, 1), Midpoint(Addition(LINE)), 1),
        (np.zeros(1), np.ones(1), 1.0), {}
    ),
    "unequal steps, beginning weighted": lambda: (
        Solver(SLEW, Theta(Cayley(RIGID), 0.3), np.linspace(1.0, 2.0, 12)), SLEWS, {}
    ),
    "limits that hold at the guess": lambda: (
        Solver(OptimalControlProblem(RIGID, spacecraft, half_square, 3, control_bounds=(-10.0, 10.0)),
               Midpoint(Cayley(RIGID)), 40), SLEWS, {}
    ),
    "limits that the guess violates": lambda: (
        Solver(OptimalControlProblem(PLANE, lambda q, u: u, half_square, 2, constraints={"obstacle": obstacle}),
               Midpoint(Addition(PLANE)), 20), (np.zeros(2), np.array([1.0, 0.0]), 1.0), {}
    ),
    "a free horizon": lambda: (
        Solver(OptimalControlProblem(PLANE, PARTICLE[0], lambda q, u: 1.0, 1, control_bounds=(-1.0, 1.0)),
               Midpoint(Addition(PLANE)), 20), (np.zeros(2), np.array([1.0, 0.0]), Free(3.0)), {}
    ),
    "a sphere with parameters": lambda: (
        Solver(sphere_problem(), Midpoint(default_retraction(SPHERE)), 15), (NORTH, EAST, 1.0), {"parameters": 2.0}
    ),
    "a slew by collocation": lambda: (Solver(SLEW, Gauss(3, Cayley(RIGID)), 8), SLEWS, {}),
    "one step of collocation": lambda: (
        Solver(OptimalControlProblem(PLANE, pendulum, half_square, 1), Gauss(4, Addition(PLANE)), 1),
        (np.zeros(2), np.array([0.5, 0.0]), 1.0), {}
    ),
    "unequal steps of collocation": lambda: (
        Solver(sphere_problem(), Gauss(2, default_retraction(SPHERE)), np.linspace(1.0, 2.0, 6)), (NORTH, EAST, 1.0),
        {"parameters": 2.0}
    ),
    "collocation with limits": lambda: (
        Solver(OptimalControlProblem(RIGID, spacecraft, half_square, 3, control_bounds=(-10.0, 10.0)),
               Gauss(2, Cayley(RIGID)), 10), SLEWS, {}
    ),
    "collocation with a cap at nodes": lambda: (
        Solver(OptimalControlProblem(PLANE, lambda q, u: u, half_square, 2,
                                     node_constraints={"cap": lambda q: obstacle(q, 0)}),
               Gauss(2, Addition(PLANE)), 8), (np.zeros(2), np.array([1.0, 0.0]), 1.0), {}
    ),
    "a free end": lambda: (
        Solver(OptimalControlProblem(PLANE, *PARTICLE, terminal_cost=lambda q: 5.0 * jnp.sin(q[0]) ** 2),
               Midpoint(Addition(PLANE)), 10), (np.ones(2), Free(np.zeros(2)), 1.0), {}
    ),
    "ends that cost, by collocation": lambda: (
        Solver(OptimalControlProblem(PLANE, *PARTICLE, terminal_cost=lambda q: 5.0 * jnp.sin(q[0]) ** 2,
                                     initial_cost=lambda q: 2.0 * jnp.sum((q - 1.0) ** 4) + jnp.sum((q - 1.0) ** 2)),
               Gauss(2, Addition(PLANE)), 6), (Free(np.ones(2)), Free(np.zeros(2)), 1.0), {}
    ),
}  # fmt: skip


def posed(solver: Solver, way: tuple, monkeypatch: Any, **options: Any) -> tuple[DiscretePhase, Any]:
    """The discrete phase of a solve, and its guess."""
    seen, transcribe = [], Transcription.transcribe

    def transcribed(self: Transcription, *given: Any) -> Any:
        seen.append(transcribe(self, *given))
        return seen[-1]

    with monkeypatch.context() as patch:
        patch.setattr(Transcription, "transcribe", transcribed)
        solver.solve(*way, **options)
    return seen[0].conditions, seen[0].guess


def put(found: Trajectory, phase: DiscretePhase, iterate: Any) -> Trajectory:
    """The trajectory with what is given and with the unknowns of an iterate."""
    core_transcription.put(found, phase, iterate, 0)
    return found
