"""First guesses of a trajectory."""

from typing import Any, NamedTuple

import jax
import numpy as np

from ...manifolds import InvalidInputError
from ...manifolds.manifold import default_tolerance
from ...manifolds.numerics.ambient import Ambient
from ...retractions import DiscretizationMap
from ..evaluation import at_each
from ..problem import OptimalControlProblem, resting_control
from ..records import shapes
from .engine.layout import Layout
from .engine.start import Start


class Guess(NamedTuple):
    """A guess for ``solve``: states and controls at the stages, and costates at the N + 1 nodes (None: zero).

    Leaves carry the stages or nodes along their leading axis; a step has one stage, with ``Gauss(s, R)`` it has ``s``. What is
    known of an extremal in addition are its states at the ``nodes`` and its costates at the stages: both or neither.
    """

    states: Ambient
    controls: Any
    costates: Any = None
    nodes: Any = None
    stage_costates: Any = None

    def __repr__(self) -> str:
        return f"Guess(states={shapes(self.states)}, controls={shapes(self.controls)}, costates={shapes(self.costates)})"


def default_guess(
    problem: OptimalControlProblem, discretization: DiscretizationMap, start: Ambient, end: Ambient, steps: int
) -> Guess:
    """Guess along the curve of a retraction from start to end, or, outside its image, a walk to the end.

    The retraction is the discretization's own; where its curve does not arrive, or in very unequal steps, the default one of the
    manifold. Where the two points are opposite to each other, as attitudes half a turn apart, the walk sets out
    in a direction that is random but always the same: there are several ways round, and this is one of them. Controls rest,
    costates are zero. Raises ``DomainError`` if no curve arrives near the end.
    """
    layout = Layout.of(problem.manifold)
    begin, target = (layout.rows(jax.tree.map(np.asarray, point), 0)[None] for point in (start, end))
    fractions = (np.arange(steps) + float(discretization.theta)) / steps
    states = layout.points(Start(problem.manifold, discretization.retraction).states(begin, target, fractions)[0])
    rest = resting_control(problem.controls)
    controls = jax.tree.map(lambda leaf: np.broadcast_to(leaf, (steps, *np.shape(leaf))), rest)
    return Guess(states, controls, _zero(problem, steps))


def _zero(problem: OptimalControlProblem, steps: int) -> Any:
    return jax.tree.map(lambda s: np.zeros((steps + 1, *s.shape), s.dtype), problem.manifold.ambient)


def checked_guess(problem: OptimalControlProblem, guess: Any, steps: int, stages: int) -> Guess:
    """The guess as arrays with its costates filled in; raises where something is wrong."""
    if not isinstance(guess, Guess):
        raise InvalidInputError(f"guess must be a Guess or a Solution, got {guess!r}; try Guess(states, controls)")
    filled = guess if guess.costates is not None else guess._replace(costates=_zero(problem, steps))
    count = steps * stages
    expected = (
        ("states", problem.manifold, count),
        ("controls", problem.controls, count),
        ("costates", problem.manifold, steps + 1),
    )
    if (guess.nodes is None) != (guess.stage_costates is None):
        raise InvalidInputError("guess: nodes and stage_costates come together, and one of them is None; give both or neither")
    if guess.nodes is not None:
        expected += ("nodes", problem.manifold, steps + 1), ("stage_costates", problem.manifold, count)
    for name, manifold, length in expected:
        _check_arrays(name, getattr(filled, name), manifold, length)
        kinds = manifold.ambient
        arrays = jax.tree.map(lambda kind, leaf: np.asarray(leaf, kind.dtype), kinds, getattr(filled, name))
        filled = filled._replace(**{name: arrays})
    for what in ("states", "nodes")[: 1 if guess.nodes is None else 2]:
        for name, value in at_each(problem.manifold.violations, getattr(filled, what)).items():
            if not np.max(value) <= default_tolerance():
                worst = f"{name} reaches {np.max(value):.3g}"
                raise InvalidInputError(f"guess: {what} are not on {problem.manifold}: {worst}, expected 0")
    return filled


def _check_arrays(name: str, given: Any, manifold: Any, length: int) -> None:
    shapes_ = jax.tree.map(lambda s: (length, *s.shape), manifold.ambient)
    got = jax.tree.map(np.shape, given)
    if shapes_ != got:
        raise InvalidInputError(f"guess: {name} must have shapes {shapes_}, got {got}")
    numbers = [np.issubdtype(np.asarray(leaf).dtype, np.number) for leaf in jax.tree.leaves(given)]
    kept = zip(jax.tree.leaves(given), jax.tree.leaves(manifold.ambient), strict=True)
    if not (all(numbers) and all(np.isrealobj(leaf) or np.issubdtype(s.dtype, np.complexfloating) for leaf, s in kept)):
        raise InvalidInputError(f"guess: {name} must be real numbers, complex where points of {manifold} are; try jnp.real")
    if not all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(given)):
        raise InvalidInputError(f"guess: {name} has entries that are NaN or infinite")
