"""The compiled pass of a trial finds what moving, assembling and appraising find one after the other."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from retrax.integrators import Free, OptimalControlProblem, Solver
from retrax.integrators.boundary_value.engine import descent
from retrax.integrators.boundary_value.engine.conditions import Conditions
from retrax.integrators.boundary_value.engine.kkt_system import Assembled
from retrax.integrators.boundary_value.engine.trial import Trial
from retrax.manifolds import Euclidean
from retrax.retractions import Addition, Cayley, Gauss, Midpoint, Theta, default_retraction

from tests.integrators.problems import IDENTITY, REST, RIGID, SLEW, SLEW_END, SPHERE, half_square, spacecraft

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
}  # fmt: skip


def same(found: Any, expected: Any, atol: float = 1e-11) -> None:
    """Trees of equal arrays but for rounding, which is relative to the largest entry of each."""

    def compare(a: Any, b: Any) -> None:
        np.testing.assert_allclose(a, b, rtol=1e-9, atol=atol * max(1.0, np.max(np.abs(b), initial=0.0)))

    jax.tree.map(compare, found, expected)


def in_terms(assembled: Assembled) -> Assembled:
    """What is condensed with slopes in units of the terms that cancel in them."""
    inner = assembled.blocks.inner
    if inner is None:
        return assembled
    size, extent = np.max(np.abs(inner.points.slope)), np.array(inner.extent)
    extent[:, 4] /= size
    inner, parts = inner._replace(slope=inner.slope / size, extent=extent), max(1.0, np.max(assembled.extent.parts))
    blocks = assembled.blocks._replace(inner=inner, slope=assembled.blocks.slope / parts)
    return assembled._replace(blocks=blocks, extent=assembled.extent._replace(slope=assembled.extent.slope / parts))


def one_by_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """No trial is a part of a pursuit from now on."""
    for name in ("set_out", "pursued"):
        monkeypatch.setattr(descent, name, lambda *given: None)


@pytest.mark.parametrize("name", CASES)
def test_a_trial_is_what_its_parts_are(name, monkeypatch):
    """At every iterate of a solve, whole steps and parts of them."""
    one_by_one(monkeypatch)
    solver, way, options = CASES[name]()
    compiled, calls = Conditions.tried, []

    def checked(self: Conditions, *before: Any) -> tuple[Any, Any]:
        found = compiled(self, *before)
        if self.setting is not None:
            calls.append(self)
            iterate = self.move(*before)
            expected = self.assemble(iterate)
            same(found[0], iterate)
            same(*map(in_terms, (found[1], expected)))
            judged = self.appraised(*found)
            self._appraisal = self._survey = None
            same(judged, self.appraised(iterate, expected))
        return found

    monkeypatch.setattr(Conditions, "tried", checked)
    assert solver.solve(*way, **options).success
    # The cost of an end asks for an evaluation between the frames and the steps.
    assert bool(calls) == (name not in ("a free end", "collocation with a cap at nodes"))


def test_ends_far_apart_go_the_longer_way(monkeypatch):
    """A step many times too long leads to ends of steps that lie more than half their size apart."""
    one_by_one(monkeypatch)
    compiled, call, far = Conditions.tried, Trial.__call__, []

    def heard(self: Trial, *given: Any) -> Any:
        found = call(self, *given)
        far.append(found is None)
        return found

    def checked(self: Conditions, iterate: Any, assembled: Any, step: Any, fraction: Any) -> tuple[Any, Any]:
        if not far:
            longer = step._replace(unknowns=30 * step.unknowns)
            found = compiled(self, iterate, assembled, longer, fraction)
            moved = self.move(iterate, assembled, longer, fraction)
            same(found, (moved, self.assemble(moved)))
        return compiled(self, iterate, assembled, step, fraction)

    monkeypatch.setattr(Trial, "__call__", heard)
    monkeypatch.setattr(Conditions, "tried", checked)
    assert Solver(SLEW, Midpoint(Cayley(RIGID)), 30).solve(*SLEWS).success
    assert far[0]
    assert not any(far[1:])


def test_the_pass_is_made_for_tapes_of_one_trajectory():
    """Not where XLA evaluates, nor where threads share a function."""
    for evaluator, steps, made in (("tape", 20, True), ("xla", 20, False), ("tape", 5000, False)):
        solver = Solver(
            OptimalControlProblem(LINE, lambda q, u: u, half_square, 1), Midpoint(Addition(LINE)), 1, evaluator
        )
        traced = solver._transcription.traced(None)
        assert (traced.steps.trial(traced.nodes, 200 * steps) is not None) == made


def test_frames_of_controls_count_where_their_space_is_curved():
    """Orthonormal frames ``E`` of a sphere: ``E' E = I - u u'``; in a flat space there is nothing that keeps its
    size."""
    u = np.array([0.6, 0.0, 0.8])
    for controls, curved in ((Euclidean(3), False), (SPHERE, True)):
        problem = OptimalControlProblem(LINE, lambda q, u: u[:1], lambda q, u: q @ q / 2, controls=controls)
        nodes = Solver(problem, Midpoint(Addition(LINE)), 2)._transcription.traced(None).nodes
        found = nodes.control_support(np.broadcast_to(u, (1, 2, 1, 3)))
        assert (found is not None) == curved
        if curved:
            np.testing.assert_allclose(np.sum(found**2, axis=1), [1 - u**2], atol=1e-14)
