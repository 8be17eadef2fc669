"""The functions of a problem at a state and a control: whether they are sound there, and whether they determine the
control."""

from functools import cached_property
from itertools import pairwise
from typing import final

import jax
import numpy as np

from ...compute.jit_cache import compile_and_call
from ...errors import FAILURES
from ...manifolds import Euclidean, InvalidInputError, NotOnManifoldError, RetraxError
from ...manifolds.numerics import ambient as vec
from ...manifolds.numerics.ambient import Ambient
from ...manifolds.numerics.precision import default_tolerance, working_precision
from ..problem.initial_controls import resting_control, within_bounds
from ..problem.optimal_control_problem import OptimalControlProblem, check_functions
from .control_probing import (
    CURVATURES,
    LADDER,
    PROBE_SIZE,
    AlongLine,
    Bend,
    ControlProbe,
    FlatDirection,
    along_lines,
    find_bend,
    find_flat_directions,
    kink_words,
    probe,
    undefined_words,
)
from .function_failures import failure_words
from .requirements import leaving_words, require_values
from .smoothness.derivative_check import require_correct_derivatives
from .smoothness.problem_jumps import require_no_jumps

GUESSED_CONTROL_SHARES = 1.0, 0.1, 1e-2  # shares of a guessed control: how near to it the functions are looked at


def probes(problem: OptimalControlProblem, u: Ambient, near: float | None = None) -> tuple[np.ndarray, Ambient]:
    """Random coordinates of controls around ``u`` and random ambient covectors, the same at every call.

    The controls are inside the bounds, at most half of the way to these; ``near``: a share of ``u`` that is the size
    of the coordinates, which else is one.
    """
    draw, m = np.random.default_rng(0).standard_normal, problem.controls.dimension
    covectors = jax.tree.map(lambda s: draw((CURVATURES, *s.shape)).astype(s.dtype), problem.manifold.ambient)
    moves = PROBE_SIZE * draw((CURVATURES, m))
    if isinstance(problem.controls, Euclidean) and m:
        flat = np.ravel(np.asarray(u, float))
        if near is not None:
            moves *= near * np.where(flat != 0, np.abs(flat), 1.0)
        if problem._limits.lower:
            rooms = [np.abs(np.array(side) - flat) / 2 for side in (problem._limits.lower, problem._limits.upper)]
            moves = np.clip(moves, -rooms[0], rooms[1])
    return moves.astype(working_precision()), covectors


def inspect_problem(problem: OptimalControlProblem, q: Ambient, guessed: Ambient | None = None) -> "Inspection":
    """A look at the functions at a state, at rest or inside the bounds; near a guessed control where they are not
    finite there."""
    found = Inspection(problem, q, within_bounds(problem._limits, resting_control(problem.controls)))
    if guessed is None or not found.undefined:
        return found
    u = within_bounds(problem._limits, guessed)
    for near in GUESSED_CONTROL_SHARES:
        found = Inspection(problem, q, u, near)
        if not found.undefined:
            break
    return found


@check_functions.register
def _check(problem: OptimalControlProblem, q: Ambient, u: Ambient) -> None:
    """Raise if the functions return a wrong kind at ``(q, u)``, or are not smooth in the controls there."""
    require_values(problem)
    Inspection(problem, q, u).require_sound(problem)


@final
class Inspection:
    """A look at the functions of a problem at ``(q, u)``, at a few random controls around ``u`` and with random
    covectors.

    What several questions need is evaluated once, at the first of them.
    """

    def __init__(self, problem: OptimalControlProblem, q: Ambient, u: Ambient, near: float | None = None) -> None:
        """``near``: a share of ``u`` within which other controls are, else of one."""
        self.problem, self.q, self.u = problem, q, u
        self.directions, self._covectors = probes(problem, u, near)

    def require_sound(self, posed: OptimalControlProblem) -> None:
        """Raise if the functions return something of the wrong kind, or are not smooth in the controls.

        ``posed``: the problem of the user, whose labels the error names.
        """
        self.require_tangent(posed)
        self.require_smooth()

    def require_tangent(self, posed: OptimalControlProblem) -> None:
        """Raise if the functions are not finite, or ``dynamics`` leaves the tangent space."""
        if self.undefined:
            raise InvalidInputError(self.undefined)
        normal, size = np.max(self._probed.normals), np.max(self._probed.sizes)
        if not normal <= default_tolerance() * (1 + size):
            u = vec.taken(self._probed.controls, int(np.argmax(self._probed.normals)))
            where = leaving_words(self.problem, self.q, u, posed)
            raise NotOnManifoldError(
                f"dynamics leaves the tangent space of {where}: its normal part is {normal:.3g} (size of the velocity "
                f"{size:.3g}), expected 0; return a tangent vector, for instance manifold.projection(q, ...) of it"
            )

    def require_smooth(self) -> None:
        """Raise if the functions jump, hide their derivatives, or have a kink where ``d2H/du2`` is singular, such as
        ``|u|``.

        A kink: null directions along which ``dH/du`` is not constant, and no second derivative accounts for it.
        """
        curved = self._is_curved  # names functions that fail, before the others read them
        require_no_jumps(self.problem, self.q, self.u)
        require_correct_derivatives(self.problem, self.q, self.u)
        if curved:
            return
        for flat, bent, slopes in zip(self._every, self._bends, self._along.slopes, strict=True):
            if bent is not None and not bent.smooth:
                places = (0.0, LADDER[bent.place])
                there = [self.problem._steer(self.u, flat.bases[bent.line] + t * flat.direction) for t in places]
                raise InvalidInputError(
                    kink_words(bent, flat.direction, slopes[bent.line, [0, bent.place], bent.part], there)
                )

    @property
    def is_regular(self) -> bool:
        """Whether at one of the controls ``d2H/du2`` is invertible, or its null directions bend, as for ``u^4``."""
        if self._is_curved:
            return True
        counts = np.cumsum([0, *map(len, self._flats)])
        return any(all(bent is not None for bent in self._bends[a:b]) for a, b in pairwise(counts))

    @cached_property
    def undefined(self) -> str:
        """Words on functions that are not finite here; empty if all are."""
        return undefined_words(self.problem._limits.function_words, self._probed, self.q)

    @property
    def _is_curved(self) -> bool:
        return not all(self._flats)

    @cached_property
    def _probed(self) -> ControlProbe:
        """The functions in NumPy arrays; raises if they fail."""
        try:
            return probe(self.problem, self.q, self.u, self.directions, self._covectors)
        except RetraxError:
            raise
        except FAILURES as error:
            raise InvalidInputError(failure_words(self.problem, error, self.q, self.u)) from error

    @cached_property
    def _flats(self) -> list[list[FlatDirection]]:
        return find_flat_directions(self._probed, self.directions)

    @cached_property
    def _every(self) -> list[FlatDirection]:
        return [flat for ways in self._flats for flat in ways]

    @cached_property
    def _along(self) -> AlongLine:
        """The functions along the lines of all flat directions, in NumPy arrays."""
        bases, ways = (np.stack([getattr(flat, name) for flat in self._every]) for name in ("bases", "direction"))
        given = vec.taken(self._covectors, np.array([flat.sample for flat in self._every]))
        ladder = LADDER.astype(self.directions.dtype)
        return jax.device_get(
            compile_and_call(along_lines, self.problem, self.q, self.u, given, bases, ways, ladder)[0]
        )

    @cached_property
    def _bends(self) -> list[Bend | None]:
        return [find_bend(flat, vec.taken(self._along, k)) for k, flat in enumerate(self._every)]
