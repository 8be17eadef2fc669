"""From the iterate of a discrete trajectory to the blocks of its KKT system, point functions evaluated all at once."""

from functools import cached_property, partial
from typing import Any, ClassVar, NamedTuple, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ....compute.base import Arrays, Evaluator, PointwiseFunction
from ....manifolds import Euclidean
from ....manifolds.numerics import ambient as vec
from ....retractions import DiscretizationMap, default_retraction
from ...problem.optimal_control_problem import OptimalControlProblem
from ...problem.path_constraints import entry_words
from ...problem.point_layout import PointLayout, parameter_layout
from ...stages import ControlStage
from ...stages.explicit_runge_kutta import RK4, ExplicitRungeKutta
from ..transcription.iterate import Data, Known, Slacks, Unknowns
from .inequalities import Held, raised
from .scaling import Units

ASIDE = 1e-3  # of the chord
QUARTER = np.pi / 2 - 1e-2  # a turn: opposite points still have a direction


class Blocks(NamedTuple):
    """The part of the KKT system that belongs to the steps; z unknowns of a step, the n of its centre first."""

    hessian: np.ndarray  # (B, N, z, z)
    left: np.ndarray  # (B, N, n, z): derivative of the beginning of a step in the frame of the node there
    right: np.ndarray  # (B, N, n, z): of its end
    slope: np.ndarray  # (B, N, z): of the Lagrangian
    gradient: np.ndarray  # (B, N, z): of the cost alone
    costs: np.ndarray  # (B, N)
    inner: Any = None  # what was condensed, if anything was
    held: Held | None = None  # the inequalities, if there are any; then the Hessian has their share
    # (B, N, z, 2): the slope with the share of the inequalities, the second times the barrier.
    pushed: np.ndarray | None = None

    @property
    def inequalities(self) -> Held:
        """The inequalities, where there are some."""
        if self.held is None:
            raise RuntimeError("there are no inequalities; assemble an iterate that has slacks")
        return self.held


class Moves(NamedTuple):
    """Steps of the unknowns (B, N, z) and of the nodes' multipliers (B, N + 1, n), and what fraction (B,) of them is
    made."""

    steps: np.ndarray
    multipliers: np.ndarray
    fraction: np.ndarray
    inner: Any = None  # the steps of what was condensed


class Terminal(NamedTuple):
    """The cost of the last node, or of the first: value (B,), ambient derivative (B, E), slope (B, n), curvature (B, n,
    n)."""

    value: np.ndarray
    derivative: np.ndarray
    slope: np.ndarray
    curvature: np.ndarray


Paid = tuple[Terminal | None, Terminal | None]  # what the first and the last node cost, if anything
AtStages = tuple[np.ndarray, np.ndarray, np.ndarray]  # states, controls and costates


def is_kept(known: tuple[int, Any], count: int) -> bool:
    """Whether what is known is the pass for so many steps, or that there is none, and its tapes are as they are now."""
    return known[0] == count and (known[1] is None or known[1].is_current)


@final
class OneStage:
    """The steps of a discretization map: unknowns ``(x, u)``, tangent vector ``h X(x, u)``.

    The inequalities of a step are those at its point, then those at nodes, at its end and at its beginning.
    """

    places: ClassVar[int] = 1  # where a step has inequalities

    def __init__(
        self, problem: OptimalControlProblem, method: DiscretizationMap, parameters: Any, evaluator: Evaluator
    ) -> None:
        self.problem, self.method, self.stages = problem, method, 1
        self.manifold, self.controls = problem.manifold, problem.controls
        self.dimension = self.manifold.dimension + self.controls.dimension
        self.state, self.control, self.parameter = (
            PointLayout.of(self.manifold),
            PointLayout.of(self.controls),
            parameter_layout(parameters),
        )
        sizes = self.state.size, self.control.size
        given = 1, self.parameter.size
        nodes = (self.state.size,) * 4
        bound = problem.with_parameters(parameters)
        self.inequalities, self.own = inequalities_of(bound), len(bound._inequality_names)
        self.kept = kept_of(bound)
        self._ends = evaluator.values(self._ends_of, *sizes, *given)
        self._row = evaluator.derivatives(self._row_of, self.dimension, *sizes, *nodes, *given, self.inequalities)
        self._move = evaluator.values(self._moved, *sizes, self.dimension, *given)
        self._pull = evaluator.values(self._pulled, *sizes, *nodes[:2], *given, self.inequalities - self.own)
        self._trial: tuple[int, Any] | None = None

    def stage(self, step: Array, parameters: Array) -> ControlStage:
        """The stage with a step length and parameters, in a function that is traced."""
        bound = self.problem.with_parameters(self.parameter.point(parameters))
        return ControlStage(problem=bound, discretization=self.method, step=step[0])

    def trial(self, nodes: "Nodes", count: int) -> Any:
        """The compiled pass of a trial of one trajectory of so many steps, if there is one; the last one is kept."""
        known = self._trial
        if known is None or not is_kept(known, count):
            from .one_stage_trial import OneStageTrial

            known = self._trial = count, OneStageTrial.of(self, nodes, count)
        return known[1]

    def ends(self, unknowns: Unknowns, data: Data) -> Arrays:
        """Beginnings and ends of the steps, shape (B, N, E)."""
        return self._ends.at(2, unknowns.centres, unknowns.controls[:, :, 0], *_given(data))

    def blocks(
        self, unknowns: Unknowns, nodes: np.ndarray, costates: np.ndarray, data: Data, slacks: Slacks | None = None
    ) -> Blocks:
        """The blocks at an iterate with these states and covectors at the nodes, shape (B, N + 1, E)."""
        around = nodes[:, :-1], nodes[:, 1:], costates[:, :-1], costates[:, 1:]
        pull = np.zeros((*data.steps.shape, self.inequalities)) if slacks is None else slacks.multipliers[:, :, 0]
        found = self._row.at(2, unknowns.centres, unknowns.controls[:, :, 0], *around, *_given(data), pull)
        hessian, slope, left, right, gradient, pushes, _, _, cost, limits = found
        blocks = Blocks(hessian, left, right, slope, gradient[:, :, 0], cost[:, :, 0])
        if slacks is None:
            return blocks
        held = Held(limits[:, :, None], pushes[:, :, None], self.weights(data))
        pushed = raised(hessian[:, :, None], slope[:, :, None], held, slacks)
        return blocks._replace(held=held, pushed=pushed[:, :, 0])

    def weights(self, data: Data) -> np.ndarray:
        """Weights of the inequalities, shape (B, N, 1, c)."""
        return data.steps[:, :, None, None] * data.held(self.inequalities, 1)

    def scaled(self, unknowns: Unknowns, factor: np.ndarray) -> Unknowns:
        """The unknowns with all costates among them times factors: there are none."""
        del factor
        return unknowns

    def at_each(self, moves: Moves, data: Data) -> np.ndarray:
        """The steps of the unknowns of each point, shape (B, N, 1, z)."""
        del data
        return moves.steps[:, :, None]

    def sizes(self, units: Units) -> np.ndarray:
        """Units of the unknowns of each point, shape (B, 1, 1, z)."""
        return units.unknowns[:, None, None]

    def limits(self, blocks: Blocks, steps: np.ndarray) -> np.ndarray:
        """Derivatives of the inequalities in the unknowns of the steps, shape (B, N, c, z)."""
        del steps
        return blocks.inequalities.jacobian[:, :, 0]

    def begin(
        self, states: np.ndarray, controls: np.ndarray, costates: np.ndarray, data: Data, known: Known | None = None
    ) -> Unknowns:
        """Unknowns from states and controls at the stages, shape (B, N, 1, ...), and costates at the nodes."""
        del costates, data, known
        return Unknowns(states[:, :, 0], controls)

    def move(self, unknowns: Unknowns, blocks: Blocks, step: Moves, data: Data) -> Unknowns:
        """The unknowns moved by fractions of steps in their charts."""
        del blocks
        steps, part = step.steps, step.fraction
        some = part[:, None, None] * steps
        x, u = self._move.at(2, unknowns.centres, unknowns.controls[:, :, 0], some, *_given(data))
        return Unknowns(x, u[:, :, None])

    def at_stages(self, unknowns: Unknowns, costates: np.ndarray, data: Data, slacks: Slacks | None) -> AtStages:
        """States, controls and costates at the stages, (B, N, ...), from covectors at the nodes, (B, N + 1, E)."""
        x, u = unknowns.centres, unknowns.controls[:, :, 0]
        none = np.zeros((*data.steps.shape, self.inequalities - self.own))
        pull = none if slacks is None else slacks.multipliers[:, :, 0, self.own :]
        (covectors,) = self._pull.at(2, x, u, costates[:, :-1], costates[:, 1:], *_given(data), pull)
        return x, u, covectors

    def _ends_of(self, x: Array, u: Array, h: Array, parameters: Array) -> tuple[Array, ...]:
        ends = self.stage(h, parameters).ends((self.state.point(x), self.control.point(u)))
        return tuple(map(self.state.flat, ends))

    def _row_of(self, d: Array, x: Array, u: Array, *given: Array) -> tuple[Array, tuple[Array, ...]]:
        q0, q1, p0, p1 = map(self.state.point, given[:4])
        stage, y = self.stage(*given[4:6]), (self.state.point(x), self.control.point(u))
        moved = stage.move(y, stage.frame(y), d)
        begin, finish = stage.ends(moved)
        cost, limits = stage.cost(moved), stage.problem.inequalities(*moved)
        limits = jnp.concatenate([limits, *(stage.problem.node_inequalities(end) for end in (finish, begin))])
        e0, e1 = self.manifold.basis(q0), self.manifold.basis(q1)
        values = vec.components(e0, begin), vec.components(e1, finish), cost[None], limits
        lagrangian = cost + vec.pairing(p0, begin) - vec.pairing(p1, finish) + given[4][0] * given[6] @ limits
        return lagrangian, values

    def _moved(self, x: Array, u: Array, d: Array, h: Array, parameters: Array) -> tuple[Array, Array]:
        stage, y = self.stage(h, parameters), (self.state.point(x), self.control.point(u))
        centre, control = stage.move(y, stage.frame(y), d)
        return self.state.flat(centre), self.control.flat(control)

    def _pulled(self, x: Array, u: Array, p0: Array, p1: Array, *given: Array) -> tuple[Array]:
        """The covector of the lift of the discretization map at a stage, between the jumps at its ends."""
        (h, parameters, pull), y = given, (self.state.point(x), self.control.point(u))
        stage, nodes, covectors = self.stage(h, parameters), pull.size // 2, [self.state.point(p) for p in (p0, p1)]
        if nodes:
            jumps = (h[0] * pull[nodes:], -h[0] * pull[:nodes]), stage.ends(y)
            slopes = [
                jax.vjp(stage.problem.node_inequalities, end)[1](jump)[0] for jump, end in zip(*jumps, strict=True)
            ]
            covectors = [vec.add(p, slope) for p, slope in zip(covectors, slopes, strict=True)]
        return (self.state.flat(stage.covector(y, *covectors)),)


def inequalities_of(problem: OptimalControlProblem) -> int:
    """How many inequalities a step has: those at a point, and those at nodes, at its end and at its beginning."""
    return len(problem._inequality_names) + 2 * len(entry_words(problem._node_sizes))


def kept_of(problem: OptimalControlProblem) -> np.ndarray:
    """Which inequalities of a step are bounds of what is free: no iterate leaves these."""
    once = problem._limits.once(problem._inequality_sizes)
    return np.append(once, np.zeros(inequalities_of(problem) - len(once), bool))


def _given(data: Data) -> tuple[np.ndarray, np.ndarray]:
    return data.steps[:, :, None], data.parameters[:, None]


@final
class Nodes:
    """What belongs to the nodes: frames, the terminal cost at the last, and the initial cost at the first."""

    def __init__(self, problem: OptimalControlProblem, parameters: Any, evaluator: Evaluator) -> None:
        self.problem, self.layout, self.parameter = (
            problem,
            PointLayout.of(problem.manifold),
            parameter_layout(parameters),
        )
        self.control, self._evaluator = PointLayout.of(problem.controls), evaluator
        self.dimension, e = problem.manifold.dimension, self.layout.size
        self._in_frame = evaluator.values(self._in_frame_of, e, self.dimension, e, e)
        costs = {"first_cost": problem.initial_cost, "final_cost": problem.terminal_cost}
        sizes = self.layout.size, self.parameter.size
        self._paid = {
            name: evaluator.values(partial(self._cost_of, name), *sizes)
            for name, cost in costs.items()
            if cost is not None
        }
        flat = isinstance(problem.controls, Euclidean)
        self.flat_controls = flat
        self._directions = None if flat else evaluator.values(self._directions_of, self.control.size)

    def in_frames(self, nodes: np.ndarray, fixed: np.ndarray, gaps: np.ndarray, covectors: np.ndarray) -> Arrays:
        """Bases of the tangent spaces (B, N + 1, n, E); coordinates of gaps and covectors in them; the covectors with
        these.

        ``fixed``: 1 for the coordinates that count, else 0, shape (B, N + 1, n).
        """
        return self._in_frame.at(2, nodes, fixed, gaps, covectors)

    def paid(self, first: np.ndarray, last: np.ndarray, parameters: np.ndarray) -> Paid:
        """The initial cost at first nodes and the terminal cost at last nodes, shape (B, E), where there are such."""
        costs = (self._paid.get(name) for name in ("first_cost", "final_cost"))
        ends = zip(costs, (first, last), strict=True)
        first_cost, final_cost = (cost and Terminal(*cost.at(1, end, parameters)) for cost, end in ends)
        return first_cost, final_cost

    @property
    def pays(self) -> bool:
        """Whether an end costs something."""
        return bool(self._paid)

    def control_sizes(self, controls: np.ndarray) -> np.ndarray:
        """Largest sizes of the controls in their coordinates, shape (B, s m), from flat controls of shape (B, N, s,
        U)."""
        largest = np.max(np.abs(controls), axis=1)
        if self._directions is not None:
            directions = np.max(np.abs(self._directions.at(3, controls)[0]), axis=1)
            largest = np.max(directions * largest[:, :, None], axis=-1, initial=0.0)
        return largest.reshape(len(largest), -1)

    def control_support(self, controls: np.ndarray) -> np.ndarray | None:
        """Largest entries of the frames at the controls, shape (B, m, U), unless their space is flat."""
        if self._directions is None:
            return None
        return np.max(np.abs(self._directions.at(3, controls)[0]), axis=(1, 2))

    def amid(self, first: np.ndarray, second: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Points amid pairs of points, shape (K, E); arcs over chords, and what these promise over the chords, entry by
        entry.

        Each column of a point is taken to run along a circle: with the half chord s and the sagitta c between its ends,
        tan(angle / 4) = c / s. A tangent vector at the middle moves the chord by the cosine of angle / 2.
        """
        middle, columns = self._middle.of_any(1, first, second)[0], self.layout.in_columns
        found = np.where(np.all(np.isfinite(middle), axis=1, keepdims=True), middle, first)
        sagitta, half = (np.sqrt(a**2 @ columns.T) for a in ((first + second) / 2 - found, (second - first) / 2))
        angle = np.where(half > 0, 2 * np.arctan2(sagitta, np.where(half > 0, half, 1.0)), 0.0)  # of half the arc
        angle = np.minimum(angle, QUARTER)
        arcs = np.where(angle > 0, angle / np.sin(np.where(angle > 0, angle, 1.0)), 1.0)
        return found, arcs @ columns, (arcs * np.cos(angle)) @ columns

    @cached_property
    def _middle(self) -> PointwiseFunction:
        """Traced where ends are far apart for the first time; it reads nothing but the manifold."""
        return self._evaluator.values(self._middle_of, self.layout.size, self.layout.size)

    @cached_property
    def roll_out(self) -> ExplicitRungeKutta:
        """Traced where a guess is rolled out for the first time."""
        return ExplicitRungeKutta(self.problem, default_retraction(self.problem.manifold), RK4, self.parameter)

    def _middle_of(self, a: Array, b: Array) -> tuple[Array]:
        """The point of the manifold next to the middle of the chord, by a few steps along its tangential part.

        The first sets out a little aside, because the chord to an opposite point has no tangential part.
        """
        x, y, retraction = self.layout.point(a), self.layout.point(b), default_retraction(self.problem.manifold)
        project = self.problem.manifold.projection
        draw = np.random.default_rng(0).standard_normal
        off = jax.tree.map(lambda leaf: jnp.asarray(draw(leaf.shape).astype(leaf.dtype)), self.problem.manifold.ambient)

        def out(chord: Array, part: Array, off: Array) -> Array:
            length = jnp.linalg.norm(chord)
            part = part + ASIDE * length * off
            size = jnp.linalg.norm(part)
            return jnp.where(size > 0, length / 2 / jnp.where(size > 0, size, 1.0), 0.0) * part

        chord = vec.subtract(y, x)
        m = retraction(x, jax.tree.map(out, chord, project(x, chord), project(x, off)))
        for _ in range(4):
            m = retraction(m, project(m, vec.subtract(vec.scale(0.5, vec.add(x, y)), m)))
        return (self.layout.flat(m),)

    def _in_frame_of(self, q: Array, fixed: Array, gap: Array, covector: Array) -> tuple[Array, ...]:
        frame = self.layout.flat_frame(self.problem.manifold.basis(self.layout.point(q)))
        coordinates = fixed * (frame @ covector)
        return frame, fixed * (frame @ gap), coordinates, coordinates @ frame

    def _directions_of(self, u: Array) -> tuple[Array]:
        return (self.control.flat_frame(self.problem.controls.basis(self.control.point(u))),)

    def _cost_of(self, name: str, q: Array, parameters: Array) -> tuple[Array, ...]:
        cost = getattr(self.problem.with_parameters(self.parameter.point(parameters)), name)
        point, layout = self.layout.point(q), self.layout
        frame = self.problem.manifold.basis(point)
        derivative = vec.gradient(cost, point)
        push = jax.vmap(lambda e: jax.jvp(lambda x: vec.gradient(cost, x), (point,), (e,))[1])(frame)
        curvature = jax.vmap(lambda image: vec.components(frame, image))(push)
        return cost(point), layout.flat(derivative), vec.components(frame, derivative), curvature
