"""The members of a batch: what each trajectory is asked for, checked."""

from collections.abc import Iterator, Sequence
from numbers import Number
from typing import Any, NamedTuple

import jax
import numpy as np

from ...manifolds import InvalidInputError, Manifold, Product
from ...manifolds.numerics.ambient import is_finite_number
from ..free import Free, guessed
from ..options import HORIZON
from ..problem import OptimalControlProblem
from .arguments import check_parameters
from .end_points import NodeCondition, boundary_conditions
from .guess import Guess, checked_guess
from .resampling import Mesh, resampled
from .solution import Solution


class Member(NamedTuple):
    """What one trajectory is asked for, as it was given."""

    start: Any
    end: Any
    horizon: float
    guess: Guess | None
    parameters: Any

    @classmethod
    def checked(cls, problem: OptimalControlProblem, mesh: Mesh, given: tuple[Any, Any, Any, Any, Any]) -> "Member":
        """The arguments ``start, end, horizon, guess, parameters``, checked; a guess that is a solution is resampled."""
        start, end, horizon, guess, parameters = given
        if not (is_finite_number(horizon) and horizon > 0):
            hint = "" if isinstance(horizon, Number) else f"; {HORIZON}"
            raise InvalidInputError(f"horizon must be a positive finite time, got {horizon!r}{hint}")
        check_parameters(problem, parameters)
        if guess is not None:
            guess = resampled(guess, mesh) if isinstance(guess, Solution) else guess
            guess = checked_guess(problem, guess, len(mesh.fractions), len(mesh.stages))
        return cls(start, end, float(horizon), guess, parameters)

    def conditions(self, problem: OptimalControlProblem) -> tuple[NodeCondition, NodeCondition]:
        """The boundary conditions."""
        return boundary_conditions(problem.manifold, self.start, self.end, self.guess is not None)


def members_of(
    problem: OptimalControlProblem, mesh: Mesh, starts: Any, ends: Any, horizons: Any, guesses: Any, parameters: Any
) -> Iterator[Member]:
    """The members of a batch one by one; see ``Member.checked``."""
    manifold = problem.manifold
    lengths = [*_lengths_of(manifold, starts), *_lengths_of(manifold, ends), *(np.shape(h) for h in [horizons] if np.ndim(h))]
    lengths += [np.shape(leaf)[:1] for leaf in jax.tree.leaves(parameters)]
    several = isinstance(guesses, Sequence) and not isinstance(guesses, Guess)
    lengths += [(len(guesses),)] if several else []
    if len(set(lengths)) != 1 or not lengths[0]:
        raise InvalidInputError(
            f"starts, ends, horizons, parameters and guesses have leading axes of lengths {sorted(set(lengths))}, expected "
            "one length B, wherever there is such an axis; for a single trajectory call solve"
        )
    for k in range(lengths[0][0]):
        pair = _member_of(manifold, starts, k), _member_of(manifold, ends, k)
        given = jax.tree.map(lambda leaf, k=k: np.asarray(leaf)[k], parameters)
        horizon = np.asarray(horizons)[k].item() if np.ndim(horizons) else horizons
        yield Member.checked(problem, mesh, (*pair, horizon, guesses[k] if several else guesses, given))


def _lengths_of(manifold: Manifold, given: Any) -> list[tuple[int, ...]]:
    """Lengths of the leading axes that points have in addition."""
    if given is None:
        return []
    if isinstance(manifold, Product) and isinstance(given, tuple | list) and len(given) == len(manifold.factors):
        return [length for pair in zip(manifold.factors, given, strict=True) for length in _lengths_of(*pair)]
    given = guessed(given)
    return [np.shape(given)[:1]] if _is_batch(manifold, given) else []


def _member_of(manifold: Manifold, given: Any, k: int) -> Any:
    """Member ``k`` of what may be a batch of points, with None where they are free."""
    if given is None:
        return None
    if isinstance(manifold, Product) and isinstance(given, tuple | list) and len(given) == len(manifold.factors):
        return tuple(_member_of(factor, part, k) for factor, part in zip(manifold.factors, given, strict=True))
    if not _is_batch(manifold, guessed(given)):
        return given
    return given.member(k) if isinstance(given, Free) else jax.tree.map(lambda leaf: np.asarray(leaf)[k], given)


def _is_batch(manifold: Manifold, given: Any) -> bool:
    shapes = [np.ndim(leaf) for leaf in jax.tree.leaves(given)]
    return shapes == [len(leaf.shape) + 1 for leaf in jax.tree.leaves(manifold.ambient)]
