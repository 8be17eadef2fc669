"""Trajectories of many kinds for the core: methods, meshes, limits, free ends, parameters."""

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np
from retrax.compute.binding.transcription import Trajectory
from retrax.integrators import Free, OptimalControlProblem, Solver
from retrax.integrators.boundary_value.transcription import core_transcription
from retrax.integrators.boundary_value.transcription.discrete_phase import DiscretePhase
from retrax.integrators.boundary_value.transcription.transcribed_problem import Transcription
from retrax.retractions import Addition, Gauss

from ..integrators.search_cases import CASES as SEARCHES
from ..integrators.search_cases import PARTICLE, PLANE

CASES: dict[str, Callable[[], tuple[Solver, tuple, dict[str, Any]]]] = {
    **SEARCHES,
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
    found.take(core_transcription.arrays_of_member(phase, iterate, 0))
    return found
