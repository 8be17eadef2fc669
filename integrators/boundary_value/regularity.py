"""Whether a problem is regular or singular with the parameters of a call, found out once for each of them."""

import warnings
from functools import cached_property
from typing import Any, final

import numpy as np

from ...manifolds import InvalidInputError
from ...manifolds.numerics import ambient as vec
from ..problem.initial_controls import resting_control, within_bounds
from ..problem.optimal_control_problem import OptimalControlProblem
from ..problem_checks.control_use import unread_controls
from ..problem_checks.costs import is_steep, require_cost
from ..problem_checks.inspection import inspect_problem, probes
from ..problem_checks.requirements import require_values
from ..reporting.result_sentences import callers
from ..singular import Classification, classify
from .inputs.inputs import Inputs
from .iteration_reports import say
from .solution.record import Solution
from .transcription.transcribed_problem import Transcription

SINGULAR_WORDS = (
    "the problem is singular, its controls are not determined by dH/du = 0, and it has a free horizon, free parameters "
    "or an explicit time; expected a running cost with curvature in every control, as u @ u / 2, or bounds that hold "
    "the controls; a running cost that is constant with a free horizon is minimum time, and needs control_bounds or "
    "constraints"
)
CLASSIFYING = "the problem is singular, and is classified: functions are compiled; classification=... saves it"


@final
class Regularity:
    """The classification of a problem with the parameters that it was last asked for."""

    def __init__(self, transcription: Transcription) -> None:
        self._transcription = transcription
        self.posed: OptimalControlProblem = transcription.problem  # of a reformulation, the problem of the user
        self._classes: dict[Any, tuple[Any, Classification | None]] = {}  # with the parameters that it belongs to

    def on(self, transcription: Transcription) -> "Regularity":
        """The regularity of the problem on another mesh; both share the classifications."""
        other = Regularity(transcription)
        other.posed, other._classes = self.posed, self._classes
        return other

    @property
    def _reformulated(self) -> bool:
        return self.posed is not self._transcription.problem

    def classification(self, inputs: Inputs, k: int = 0) -> Classification | None:
        """The classification of a singular problem, None of a regular one; raises for functions that cannot be solved
        with."""
        key, values = self._key(inputs), inputs.rows[k].tobytes()
        if key not in self._classes or self._classes[key][0] != values:
            problem, (first, last), guess = inputs.problem_of(k), inputs.conditions_of(k), inputs.guess_of(k)
            known, control = (first.point, None) if guess is None else vec.taken((guess.states, guess.controls), 0)
            inspection = inspect_problem(problem, known, control)
            inspection.require_sound(self.posed)
            # Where there are inequalities the barrier determines the controls that the Hamiltonian leaves open.
            regular = inspection.is_regular or problem._limits.along
            if not regular and self._reformulated:
                raise InvalidInputError(SINGULAR_WORDS)
            require_cost(problem, (known, inspection.u, inspection.directions), last.point, last.fixed_leaves)
            excluded = None if problem.abnormal or is_steep(problem, last.fixed_leaves) else False
            if not regular:
                say(inputs.options.callback, CLASSIFYING)
                _warn_of_unread(problem)
            self._classes[key] = values, None if regular else classify(problem, exclude_zero_costate=excluded)
        return self._classes[key][1]

    def needs_proof(self, inputs: Inputs) -> bool:
        """Whether a solution can show that the problem is regular, as with earlier parameters.

        Nobody gave a classification or an integrator for the present parameters.
        """
        if not (inputs.classification is None and inputs.integrator is None):
            return False
        values, found = self._classes.get(self._key(inputs), (None, None))
        return values is not None and found is None and values != inputs.rows[0].tobytes()

    def proves(self, inputs: Inputs, solution: Solution) -> bool:
        """Whether the solution is a strict minimum, along which ``d2H/du2`` is invertible; with inequalities it need
        not be."""
        if self._transcription.problem._limits.along:
            return self._remember(inputs)
        if not (solution.success and solution.checks.strict_minimum):
            return False
        state, control = self._transcription.state, self._transcription.control
        layouts = (state, solution.stage_states), (control, solution.controls), (state, solution.stage_costates)
        states, controls, costates = (layout.rows(points, 1)[None] for layout, points in layouts)
        if not self._transcription.of(inputs).diagnosis.is_invertible((states, controls, costates), inputs.rows):
            return False
        return self._remember(inputs)

    def _remember(self, inputs: Inputs) -> bool:
        self._classes[self._key(inputs)] = inputs.rows[0].tobytes(), None
        return True

    def require_regular(self, inputs: Inputs) -> None:
        """Raise if the problem is singular with the parameters of any member.

        ``d2H/du2`` is looked at with those of each, at a few random controls and covectors at its start; where it is
        singular at all of them, the member is classified.
        """
        if not self.needs_proof(inputs):  # a look at the functions takes as long as a hundred solves
            self._require_regular(inputs, 0)
        if self._transcription.problem._limits.along or not inputs.rows.size:
            return
        _, left = np.unique(inputs.rows, axis=0, return_index=True)
        states = np.broadcast_to(inputs.ends.start, (len(inputs), self._transcription.state.size))
        for control, covector in zip(*self._probes, strict=True):
            at = (
                states[left],
                np.broadcast_to(control, (len(left), control.size)),
                np.broadcast_to(covector, states[left].shape),
            )
            curved = self._transcription.of(inputs).diagnosis.invertible(
                tuple(part[:, None] for part in at), inputs.rows[left]
            )
            left = left[~curved[:, 0]]
        for k in left:
            self._require_regular(inputs, int(k))

    def _require_regular(self, inputs: Inputs, k: int) -> None:
        try:
            found = self.classification(inputs, k)
        except InvalidInputError as error:
            if not inputs.rows.size:
                raise
            whose = "" if self._reformulated else "the parameters of "  # a reformulation adds bounds of the horizon
            raise InvalidInputError(f"with {whose}member {k}: {error}") from error
        if found is not None and not found.regular:
            which = f" with the parameters of member {k}" if inputs.rows.size else ""
            raise InvalidInputError(
                f"solve_many solves regular problems, and this one is singular{which}; call solve for each"
            )

    @cached_property
    def _probes(self) -> tuple[np.ndarray, np.ndarray]:
        """Flat controls around the resting one, and covectors, random and the same at every call."""
        problem = self._transcription.problem
        rest = within_bounds(problem._limits, resting_control(problem.controls))
        moves, covectors = probes(problem, rest)
        controls = np.stack([self._transcription.control.rows(problem._steer(rest, move), 0) for move in moves])
        return controls, self._transcription.state.rows(covectors, 1)

    def _key(self, inputs: Inputs) -> Any:
        return inputs.structure, inputs.ends.prescribed[1].parts


def _warn_of_unread(problem: OptimalControlProblem) -> None:
    """Warn of controls that no function reads: each makes a problem singular."""
    unread = unread_controls(require_values(problem), problem.quantities)
    if unread:
        warnings.warn(
            f"no function of the problem reads {', '.join(unread)}, which makes the problem singular; try fewer "
            "controls, or a cost of each control",
            stacklevel=callers(),
        )
