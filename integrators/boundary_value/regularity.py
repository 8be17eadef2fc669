"""Whether a problem is regular or singular with the parameters of a call, found out once for each of them."""

import warnings
from functools import cached_property
from typing import Any, final

import numpy as np

from ...manifolds import InvalidInputError
from ...manifolds.numerics import ambient as vec
from ..control_use import unread_controls
from ..controls import resting_control, within_bounds
from ..costs import is_steep, require_cost
from ..inspection import inspected, probes
from ..problem import OptimalControlProblem
from ..results import callers
from ..singular import Classification, classify
from .iteration_table import say
from .posed import Posing
from .request import Request
from .solution import Solution

CLASSIFYING = "the problem is singular, and is classified: functions are compiled; classification=... saves it"


@final
class Regularity:
    """The classification of a problem with the parameters that it was last asked for."""

    def __init__(self, posing: Posing, refusal: str = "") -> None:
        """``refusal``: words for a singular problem, where that is not to be solved."""
        self._posing, self.refusal = posing, refusal
        self._classes: dict[Any, tuple[Any, Classification | None]] = {}  # with the parameters that it belongs to

    def on(self, posing: Posing) -> "Regularity":
        """The same on another mesh; what is found out serves both."""
        other = Regularity(posing, self.refusal)
        other._classes = self._classes
        return other

    def classification(self, request: Request, k: int = 0) -> Classification | None:
        """The classification of a singular problem, None of a regular one; raises for functions that cannot be solved
        with."""
        key, values = self._key(request), request.rows[k].tobytes()
        if key not in self._classes or self._classes[key][0] != values:
            problem, (first, last), guess = request.problem_of(k), request.conditions_of(k), request.guess_of(k)
            known, control = (first.point, None) if guess is None else vec.taken((guess.states, guess.controls), 0)
            inspection = inspected(problem, known, control)
            inspection.require_sound()
            # Where there are inequalities the barrier determines the controls that the Hamiltonian leaves open.
            regular = inspection.is_regular or problem._limits.along
            if not regular and self.refusal:
                raise InvalidInputError(self.refusal)
            require_cost(problem, (known, inspection.u, inspection.directions), last.point, last.fixed_leaves)
            excluded = None if problem.abnormal or is_steep(problem, last.fixed_leaves) else False
            if not regular:
                say(request.options.callback, CLASSIFYING)
                _warn_of_unread(problem)
            self._classes[key] = values, None if regular else classify(problem, exclude_zero_costate=excluded)
        return self._classes[key][1]

    def has_to_be_shown(self, request: Request) -> bool:
        """Whether a solution can show that the problem is regular, as with earlier parameters.

        Nobody gave a classification or an integrator for the present parameters.
        """
        if not (request.classification is None and request.integrator is None):
            return False
        values, found = self._classes.get(self._key(request), (None, None))
        return values is not None and found is None and values != request.rows[0].tobytes()

    def is_shown(self, request: Request, solution: Solution) -> bool:
        """Whether the solution is a strict minimum, along which ``d2H/du2`` is invertible; with inequalities it need
        not be."""
        if self._posing.problem._limits.along:
            return self._shown(request)
        if not (solution.success and solution.checks.strict_minimum):
            return False
        state, control = self._posing.state, self._posing.control
        layouts = (state, solution.stage_states), (control, solution.controls), (state, solution.stage_costates)
        states, controls, costates = (layout.rows(points, 1)[None] for layout, points in layouts)
        if not self._posing.of(request).diagnosis.is_curved((states, controls, costates), request.rows):
            return False
        return self._shown(request)

    def _shown(self, request: Request) -> bool:
        self._classes[self._key(request)] = request.rows[0].tobytes(), None
        return True

    def require_regular(self, request: Request) -> None:
        """Raise if the problem is singular with the parameters of any member.

        ``d2H/du2`` is looked at with those of each, at a few random controls and covectors at its start; where it is
        singular at all of them, the member is classified.
        """
        if not self.has_to_be_shown(request):  # a look at the functions takes as long as a hundred solves
            self._require_regular(request, 0)
        if self._posing.problem._limits.along or not request.rows.size:
            return
        _, left = np.unique(request.rows, axis=0, return_index=True)
        states = np.broadcast_to(request.ends.start, (len(request), self._posing.state.size))
        for control, covector in zip(*self._probes, strict=True):
            at = (
                states[left],
                np.broadcast_to(control, (len(left), control.size)),
                np.broadcast_to(covector, states[left].shape),
            )
            curved = self._posing.of(request).diagnosis.curved(tuple(part[:, None] for part in at), request.rows[left])
            left = left[~curved[:, 0]]
        for k in left:
            self._require_regular(request, int(k))

    def _require_regular(self, request: Request, k: int) -> None:
        try:
            found = self.classification(request, k)
        except InvalidInputError as error:
            if not request.rows.size:
                raise
            whose = "" if self.refusal else "the parameters of "  # with a refusal bounds of a horizon are among them
            raise InvalidInputError(f"with {whose}member {k}: {error}") from error
        if found is not None and not found.regular:
            which = f" with the parameters of member {k}" if request.rows.size else ""
            raise InvalidInputError(
                f"solve_many solves regular problems, and this one is singular{which}; call solve for each"
            )

    @cached_property
    def _probes(self) -> tuple[np.ndarray, np.ndarray]:
        """Flat controls around the resting one, and covectors, random and the same at every call."""
        problem = self._posing.problem
        rest = within_bounds(problem._limits, resting_control(problem.controls))
        moves, covectors = probes(problem, rest)
        controls = np.stack([self._posing.control.rows(problem._steer(rest, move), 0) for move in moves])
        return controls, self._posing.state.rows(covectors, 1)

    def _key(self, request: Request) -> Any:
        return request.structure, request.ends.prescribed[1].parts


def _warn_of_unread(problem: OptimalControlProblem) -> None:
    """Warn of controls that no function reads: each makes a problem singular."""
    unread = unread_controls(problem._require_values(), problem.quantities)
    if unread:
        warnings.warn(
            f"no function of the problem reads {', '.join(unread)}, which makes the problem singular; try fewer "
            "controls, or a cost of each control",
            stacklevel=callers(),
        )
