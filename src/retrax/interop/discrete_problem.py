"""A discrete optimal control problem as a nonlinear program of CasADi."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, final

import casadi as ca
import jax
import jax.numpy as jnp
import numpy as np

from ..integrators import Guess, OptimalControlProblem, default_guess
from ..integrators.boundary_value.inputs.arguments import LIMITS, check_parameters, check_problem, step_fractions
from ..integrators.boundary_value.inputs.boundary_data import BoundaryDataReader, EndPoints, PrescribedEnd
from ..integrators.boundary_value.inputs.guess_arrays import GuessReader
from ..integrators.boundary_value.transcription.inequality_rows import InequalityRows
from ..integrators.problem.free_quantities import is_free
from ..integrators.problem_checks.requirements import require_treated
from ..manifolds import InvalidInputError
from ..manifolds.numerics.ambient import is_finite_number
from ..retractions import CollocationMethod, DiscretizationMap
from ..tape import Tape
from .transcription import Transcription


@final
@dataclass(frozen=True, eq=False)
class DiscreteProblem:
    """A discrete optimal control problem as a nonlinear program: symbols ``x``, cost ``f``, constraints ``g``, their
    bounds.

    ``nlp`` is what ``casadi.nlpsol`` takes, ``arguments`` what the solver is called with (``x0, lbx, ubx, lbg, ubg``),
    and ``guess(found)`` turns what it returns into the ``Guess`` with these states, controls and costates.
    """

    x: ca.MX
    f: ca.MX
    g: ca.MX
    x0: np.ndarray
    lbx: np.ndarray
    ubx: np.ndarray
    lbg: np.ndarray
    ubg: np.ndarray
    points: "Points"

    @property
    def nlp(self) -> dict[str, ca.MX]:
        """The program: ``{"x", "f", "g"}``."""
        return {"x": self.x, "f": self.f, "g": self.g}

    @property
    def arguments(self) -> dict[str, np.ndarray]:
        """The guess and the bounds: ``{"x0", "lbx", "ubx", "lbg", "ubg"}``."""
        return {"x0": self.x0, "lbx": self.lbx, "ubx": self.ubx, "lbg": self.lbg, "ubg": self.ubg}

    def guess(self, found: Any) -> Guess:
        """States and controls at the stages and costates at the nodes, from ``{"x", "lam_g"}`` as ``nlpsol`` returns
        them."""
        return self.points.read(*(np.asarray(ca.DM(found[name])).ravel() for name in ("x", "lam_g")))

    def initial(self, guess: Guess) -> np.ndarray:
        """The unknowns with the states and controls of another guess."""
        return self.points.unknowns(guess)


def transcribe(
    problem: OptimalControlProblem,
    method: DiscretizationMap | CollocationMethod,
    ends: tuple[Any, Any],
    horizon: Any,
    steps: Any,
    guess: Guess | None,
    parameters: Any,
) -> DiscreteProblem:
    """The program of a problem as it is given, checked."""
    check_problem(problem, method)
    require_treated(problem, "to_casadi", *LIMITS)
    check_parameters(problem, parameters)
    if not (is_finite_number(horizon) and horizon > 0):
        hint = "; a program has a given one: try that of a solution, solution.horizon" if is_free(horizon) else ""
        raise InvalidInputError(f"horizon must be a positive finite time, got {horizon!r}{hint}")
    fractions, bound = step_fractions(steps), problem.with_parameters(parameters)
    reader = BoundaryDataReader(problem.manifold)
    points = reader.ends(*ends, batched=False)
    reader.require_on_manifold(*ends)
    if guess is None:
        guess = default_guess(problem, method, *ends, steps)
    return _discrete(Transcription(bound, method), points, float(horizon) * fractions, guess)


def _discrete(functions: Transcription, points: EndPoints, lengths: np.ndarray, guess: Guess) -> DiscreteProblem:
    """The program of a problem with steps of some lengths, from a guess."""
    count, size, slack = len(lengths), functions.state.size, functions.slack
    y, s = ca.MX.sym("y", functions.size, count), ca.MX.sym("s", slack, count + 1)
    x = ca.vertcat(ca.vec(y), ca.vec(s))
    begins, finishes, costs, held, limits, stages = _function(functions.step, functions.size, 1).map(count)(
        y, lengths[None]
    )
    ends, fixed = (points.start[0], points.end[0]), [prescribed.entries for prescribed in points.prescribed]
    first, last = (
        mask * end + (1 - mask) * reached
        for mask, end, reached in zip(fixed, ends, (begins[:, 0], finishes[:, -1]), strict=True)
    )
    meeting = _function(functions.meeting, size, size, slack).map(count + 1)
    gaps = meeting(ca.horzcat(begins, ends[1]), ca.horzcat(ends[0], finishes), s)
    prescribed = np.concatenate([fixed[0], np.ones((count - 1) * size, bool), fixed[1]])
    terminal, slope = _function(functions.last, size)(last)
    nodes = ca.horzcat(first, finishes[:, :-1], last)
    limits = ca.vertcat(ca.vec(limits), _at_nodes(functions, nodes, points))
    f, g = (
        ca.sum2(costs) + terminal,
        ca.vertcat(ca.vec(gaps)[np.flatnonzero(prescribed).tolist()], ca.vec(held), limits),
    )
    bound = np.full(x.numel(), np.inf)
    unused = [*map(_unused_slacks, points.prescribed)]
    bound[x.numel() - slack * (count + 1) :][
        np.concatenate([unused[0], np.zeros((count - 1) * slack, bool), unused[1]])
    ] = 0.0
    lower = np.zeros(g.numel())
    lower[g.numel() - limits.numel() :] = -np.inf
    read = Points(functions, lengths, ca.Function("read", [x], [y, stages, nodes, slope]), prescribed)
    return DiscreteProblem(x, f, g, read.unknowns(guess), -bound, bound, lower, np.zeros(g.numel()), read)


def _at_nodes(functions: Transcription, nodes: ca.MX, points: EndPoints) -> ca.MX:
    """The inequalities at the nodes, at an end only the inequalities that depend on a free part."""
    if not functions.node_limits:
        return ca.MX(0, 1)
    rows, count = InequalityRows(functions.problem, None, functions.stages), nodes.shape[1]
    values = _function(functions.at_node, functions.state.size).map(count)(nodes)
    asked: Any = rows.mask(count - 1, points.prescribed)
    mask = np.concatenate([*rows.at_nodes(asked[None]).values()], axis=2)
    return ca.vec(values)[np.flatnonzero(mask.ravel()).tolist()]


@dataclass(frozen=True, eq=False)
class Points:
    """Between the unknowns and multipliers of a program and guesses."""

    functions: Transcription
    lengths: np.ndarray
    values: ca.Function
    prescribed: np.ndarray

    def unknowns(self, guess: Guess) -> np.ndarray:
        """The unknowns of a guess, with slacks zero."""
        functions, count = self.functions, len(self.lengths)
        checked = GuessReader(functions.problem, count, functions.stages).one(guess)
        return np.concatenate([functions.begin(checked, count).ravel(), np.zeros(functions.slack * (count + 1))])

    def read(self, x: np.ndarray, multipliers: np.ndarray) -> Guess:
        state, control = self.functions.state, self.functions.control
        y, stages, nodes, slope = (np.asarray(value).T for value in self.values(x))
        costates = np.zeros(len(self.prescribed))
        costates[self.prescribed] = multipliers[: np.count_nonzero(self.prescribed)]
        costates = costates.reshape(nodes.shape)
        ended = self.prescribed[-nodes.shape[1] :]
        costates[-1, ~ended] = -slope[0, ~ended]
        controls = self.functions.split(y)["controls"]
        tangent = jax.vmap(self.functions.manifold.projection)(state.points(nodes), state.points(costates))
        return Guess(
            state.points(stages.reshape(-1, state.size)),
            control.points(controls.reshape(-1, control.size)),
            jax.tree.map(np.asarray, tangent),
        )


def _function(function: Callable[..., tuple[jax.Array, ...]], *sizes: int) -> ca.Function:
    """A function of flat vectors as one of columns."""
    return Tape.trace(function, *map(jnp.zeros, sizes)).to_casadi()


def _unused_slacks(prescribed: PrescribedEnd) -> np.ndarray:
    """The slacks of free parts, which are zero because the ends of these parts meet nothing."""
    parts = prescribed.parts
    return np.repeat([not part.fixed for part in parts], [part.entries - part.dimension for part in parts])
