"""Linear systems and steps of trajectories by the core beside the engine's."""

from typing import Any

import numpy as np
import pytest
from retrax.compute.binding.library import best_instruction_set
from retrax.compute.binding.search import Search, SearchStatus
from retrax.compute.binding.transcription import FunctionName, LimitScale, Scale, Trajectory, Transcription
from retrax.integrators.boundary_value import regular_extremals
from retrax.integrators.boundary_value.engine import beginning, newton
from retrax.integrators.boundary_value.engine import first_units as engine_units
from retrax.integrators.boundary_value.engine.barrier import PRICES
from retrax.integrators.boundary_value.engine.conditions import Conditions
from retrax.integrators.boundary_value.engine.inequalities import BOUNDARY
from retrax.integrators.boundary_value.engine.transcription import Moves
from retrax.integrators.boundary_value.transcription import core_search
from retrax.manifolds import InvalidInputError

from ..integrators.search_cases import CASES, SLEWS

SETS = range(best_instruction_set() + 1)
NAMES = list(CASES)


def run_on_core(monkeypatch: Any, *parts: str) -> None:
    """Run these parts on the core, and all others by the engine."""
    for module in (newton, regular_extremals):
        monkeypatch.setattr(module, "PARTS_ON_CORE", frozenset(parts))


@pytest.fixture(autouse=True)
def engine(monkeypatch):
    """Solves by the engine, which these tests compare with, whatever runs on the core."""
    run_on_core(monkeypatch)


def transcription(conditions: Conditions, own: int) -> Transcription:
    """The engine's transcription for the core, which runs an instruction set."""
    return core_search.made(conditions, own)


def posed(solver: Any, way: tuple, monkeypatch: Any, **options: Any) -> tuple[Conditions, Any]:
    """The conditions of a solve, and its guess."""
    seen, begin = [], Conditions.begin

    def begun(self: Conditions, guess: Any, firm: float = 1.0) -> Any:
        seen.append((self, guess))
        return begin(self, guess, firm)

    with monkeypatch.context() as patch:
        patch.setattr(Conditions, "begin", begun)
        patch.setattr(Conditions, "setting", None)
        solver.solve(*way, **options)
    return seen[0]


def put(found: Trajectory, conditions: Conditions, iterate: Any) -> Trajectory:
    """The trajectory with what is given and with the unknowns of an iterate."""
    core_search.put(found, conditions, iterate, 0)
    if iterate.slacks is not None:
        names = "SLACKS", "LIMIT_MULTIPLIERS", "EXCESSES", "PENALTIES"
        for name, array in zip(names, iterate.slacks, strict=False):
            found[name][...] = core_search.flat_limits(conditions.transcription, array[0])
        found["BARRIER"][...] = iterate.slacks.barrier
    return found


def compare(found: Trajectory, expected: dict[str, np.ndarray]) -> None:
    """Equal arrays but for rounding, which is relative to the largest entry of each."""
    for name, array in expected.items():
        size = max(1.0, np.abs(array).max(initial=0.0))
        np.testing.assert_allclose(found[name], np.ravel(array), rtol=1e-9, atol=2e-11 * size, err_msg=name)


def system(assembled: Any, steps: Any) -> dict[str, np.ndarray]:
    """The engine's arrays by their names in the core."""
    blocks, inner = assembled.blocks, assembled.blocks.inner
    found = {
        "NODES": assembled.nodes, "DEFECTS": assembled.gap, "ASKED": assembled.asked, "NODE_FRAMES": assembled.frames,
        "MULTIPLIERS": assembled.coordinates, "NODE_COSTATES": assembled.costates, "DISTANCE": assembled.distance,
        "LEFT": blocks.left, "RIGHT": blocks.right, "GRADIENTS": blocks.gradient, "COSTS": blocks.costs,
    }  # fmt: skip
    if inner is not None:
        found |= {"POINT_DEFECTS": inner.defect, "POINT_MULTIPLIERS": inner.multipliers, "POINT_FRAMES": inner.frames}
        found |= {"GRADIENTS_BY_VELOCITIES": inner.gradient}
    found |= {"HESSIANS": blocks.hessian, "RIGHT_SIDES": blocks.slope}
    if blocks.held is not None:
        found |= {"RIGHT_SIDES": blocks.pushed[..., 0], "BARRIER_SIDES": blocks.pushed[..., 1], "SLOPES": blocks.slope}
        found["LIMITS"] = core_search.flat_limits(steps, blocks.held.values[0])
        if steps.places == steps.stages:
            found["LIMIT_JACOBIANS"] = blocks.held.jacobian
    names = "HIGHEST", "LOWEST", "SUPPORT", None, "MISSING", "LACKING", None, "PARTS", "LARGEST_SLOPES", "CURVATURES"
    found |= {name: own for name, own in zip(names, assembled.extent, strict=True) if name}
    if inner is not None and blocks.held is None:  # the engine takes the slopes of Newton's step for those of the cost
        del found["LARGEST_SLOPES"]
    return found


@pytest.mark.parametrize("name", NAMES)
def test_systems_and_steps_are_those_of_the_engine(name, monkeypatch):
    """Along a solve, at all iterates and for all steps and parts of steps; the cases share out the instruction sets."""
    own = SETS[NAMES.index(name) % len(SETS)]
    solver, way, options = CASES[name]()
    made, moves, given = [0, 0, 0, 0], {}, []
    natural_units, units_of = engine_units.natural_units, engine_units.first_units
    assemble, move, appraise = Conditions.assemble, Conditions.move, Conditions.appraised

    def of(conditions: Conditions) -> Transcription:
        key = id(conditions.transcription)
        if key not in moves:
            moves[key] = transcription(conditions, own)
        return moves[key]

    def assembled(self: Conditions, iterate: Any, paid: Any = None) -> Any:
        found = assemble(self, iterate, paid)
        at = put(of(self).trajectory(), self, iterate)
        at.evaluate()
        compare(at, system(found, self.transcription))
        made[0] += 1
        return found

    def appraised(self: Conditions, iterate: Any, assembled: Any) -> Any:
        found = appraise(self, iterate, assembled)
        at, limits, least = put(of(self).trajectory(), self, iterate), None, 0.0
        at.evaluate()
        if self.barrier is not None and iterate.slacks is not None:
            limits = LimitScale(float(self.barrier.rate[0]), self.barrier.limits[0], *PRICES)
            least = float(self.judging.cost[0])
        own = [Scale(*map(np.ascontiguousarray, (a.unknowns[0], a.nodes[0])), float(a.cost[0])) for a in
               (self.judging, self.measured)]  # fmt: skip
        at.measure(*own, limits, least)
        numbers = np.concatenate([*found.residuals, *found[3:]])
        near = assembled.blocks.inner is None or limits is not None or found.residuals.gap[0] < 1e-9
        told = np.arange(len(numbers)) if near else [0, 2, 3, 4, 5, *range(9, 14)]
        np.testing.assert_allclose(
            at["RESIDUALS"][told], numbers[told], rtol=1e-7, atol=1e-9 * max(1.0, abs(numbers[9:12]).max())
        )
        compare(at, {"ALONG": found.along, "ENTRIES": found.entries})
        if limits is not None:
            np.testing.assert_allclose(at["LIMIT_SURVEY"], self._survey_of(iterate, assembled)[:, 0], rtol=1e-8)
        made[2] += 1
        return found

    def measured(system: Any, gradient: Any, states: Any, controls: Any, values: Any, curved: Any, room: Any) -> Any:
        found = natural_units(system, gradient, states, controls, values, curved, room)
        given.append((np.concatenate([states, controls], axis=1)[0], np.array(values[0]), controls, curved, room))
        return found

    def first_units(conditions: Conditions, iterate: Any, assembled: Any, least: Any = 0.0) -> Any:
        found = units_of(conditions, iterate, assembled, least)
        at = put(of(conditions).trajectory(), conditions, iterate)
        at.evaluate()
        moved = assembled.extent.moved(conditions.at_nodes.layout)
        for own, expected in zip(at.motion(), moved, strict=True):
            np.testing.assert_allclose(own, expected[0], rtol=1e-9)
        sizes, values, controls, curved, room = given.pop()
        free, bent = np.broadcast_to(room, controls.shape)[0].copy(), bool(np.all(curved))
        scale = at.scale(sizes, values, free, bent)
        # A size that a curvature of rounding asks for is rounding too.
        curvature = assembled.extent.curvature[0]
        told = (curvature == 0) | (curvature > 1e-9 * curvature.max())
        np.testing.assert_allclose(scale.unknowns[told], found.unknowns[0][told], rtol=1e-6)
        if told.all():
            np.testing.assert_allclose(scale.nodes, found.nodes[0], rtol=1e-6)
            np.testing.assert_allclose(scale.cost, found.cost[0], rtol=1e-6)
        made[3] += told.all()
        return found

    def moved(self: Conditions, iterate: Any, before: Any, step: Any, fraction: np.ndarray) -> Any:
        found = move(self, iterate, before, step, fraction)
        at, to = (put(of(self).trajectory(), self, iterate) for _ in range(2))
        at.evaluate()
        at["STEPS"][...], at["MULTIPLIER_STEPS"][...] = step.unknowns.ravel(), step.multipliers.ravel()
        at.expand()
        if step.inner is not None:
            compare(at, dict(zip(("VELOCITY_STEPS", "POINT_MULTIPLIER_STEPS"), step.inner, strict=True)))
        to.move(at, float((fraction * step.reach)[0]))
        if step.turn is not None:
            at.step_inequalities(BOUNDARY)
            turn, names = step.turn, ("SLACK_STEPS", "LIMIT_MULTIPLIER_STEPS", "EXCESS_STEPS")
            flat = [core_search.flat_limits(self.transcription, a[0]) for a in (*turn[:3], *found.slacks[:3])]
            compare(at, dict(zip(names, flat[:3], strict=True)))
            np.testing.assert_allclose(
                at["LIMIT_STEP"][1:], np.ravel([turn.dual, turn.ahead, turn.lacking]), rtol=1e-7, atol=1e-9
            )
            assert turn.reach[0] == pytest.approx(min(1.0, at["LIMIT_STEP"][0]), rel=1e-9)
            to.move_inequalities(at, float((fraction * turn.reach)[0]), float(turn.dual[0]))
            names = "SLACKS", "LIMIT_MULTIPLIERS", "EXCESSES"
            compare(to, dict(zip(names, flat[3:], strict=True)))
        unknowns = {"CENTRES": found.unknowns.centres, "CONTROLS": found.unknowns.controls, "COSTATES": found.costates}
        if step.inner is not None:
            unknowns |= {"VELOCITIES": found.unknowns.velocities, "POINT_COSTATES": found.unknowns.costates}
        compare(to, unknowns)
        made[1] += 1
        return found

    monkeypatch.setattr(Conditions, "assemble", assembled)
    monkeypatch.setattr(Conditions, "move", moved)
    monkeypatch.setattr(Conditions, "appraised", appraised)
    monkeypatch.setattr(engine_units, "natural_units", measured)
    monkeypatch.setattr(beginning, "first_units", first_units)
    monkeypatch.setattr(Conditions, "setting", None)
    assert solver.solve(*way, **options).success
    assert min(made) > 0


@pytest.mark.parametrize("share", [0.1, 0.5, 0.7, 0.9, 1.0])
def test_ends_that_are_far_apart_meet_as_in_the_engine(share, monkeypatch):
    """Centres at random attitudes: gaps from small ones to half turns, and of single nodes."""
    conditions, guess = posed(CASES["a slew"]()[0], SLEWS, monkeypatch)
    rng = np.random.default_rng(int(10 * share))
    turn = conditions.transcription.move
    moves = Moves(
        np.pi * rng.standard_normal((1, 30, conditions.transcription.dimension)) * (rng.random((1, 30, 1)) < share),
        np.zeros((1, 31, conditions.at_nodes.dimension)),
        np.ones(1),
    )
    far = guess._replace(unknowns=turn(guess.unknowns, None, moves, conditions.data))
    at = put(transcription(conditions, SETS[-1]).trajectory(), conditions, far)
    at.evaluate()
    expected = conditions.assemble(far)
    assert not np.allclose(expected.asked, expected.gap)
    compare(at, system(expected, conditions.transcription))


def test_what_does_not_fit_is_refused(monkeypatch):
    conditions, _ = posed(CASES["a slew"]()[0], SLEWS, monkeypatch)
    right = transcription(conditions, 0)
    programs, (name, sizes) = dict(right.programs), (FunctionName, right.sizes)
    none = np.zeros(0)
    tableau, columns = (np.ones((1, 1)), np.ones(1)), (np.zeros(sizes.state_numbers, np.intp),) * 2
    for wrong, words in (
        (sizes._replace(steps=0), "larger than the core takes"),
        (sizes._replace(steps=1 << 40), "larger than the core takes"),
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
def test_searches_end_where_those_of_the_engine_do(name, monkeypatch):
    solver, way, options = CASES[name]()
    expected = solver.solve(*way, tolerance=1e-10, **options)
    conditions, guess = posed(solver, way, monkeypatch, **options)
    search = Search(transcription(conditions, SETS[-1]), 1e-10, 100)
    put(search.trajectory, conditions, guess._replace(slacks=None))
    status = search.run()
    assert status is SearchStatus.CONVERGED, status
    assert search.trajectory["TOTALS"][0] == pytest.approx(expected.cost, rel=1e-9)
    found = search.read()
    assert found.claimed
    assert found.iterations == expected.statistics.iterations


@pytest.mark.parametrize("name", NAMES)
def test_what_the_memory_of_a_search_held_before_changes_no_bit(name, monkeypatch):
    solver, way, options = CASES[name]()
    conditions, guess = posed(solver, way, monkeypatch, **options)
    own, ends = transcription(conditions, SETS[-1]), []
    for held in (0.0, np.nan, 1e300):
        Search(own, 1e-10, 100)
        own.search_room(1)[...] = held
        search = Search(own, 1e-10, 100)
        put(search.trajectory, conditions, guess._replace(slacks=None))
        status, found = search.run(), search.read()
        told = [status, found.iterations, found.claimed, found.strict, found.convex, found.limits.tobytes()]
        names = "CENTRES", "CONTROLS", "COSTATES", "LIMIT_MULTIPLIERS", "RESIDUALS", "STEPS", "TOTALS"
        ends.append(told + [found.trajectory[array].tobytes() for array in names])
    assert ends[0] == ends[1] == ends[2]
