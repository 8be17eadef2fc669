"""First guesses of a trajectory."""

from typing import Any, NamedTuple

import jax
import numpy as np

from ...manifolds import InvalidInputError
from ...manifolds.manifold import default_tolerance
from ...manifolds.numerics.ambient import Ambient
from ...retractions import Gauss
from ..evaluation import at_each
from ..problem import OptimalControlProblem, resting_control
from ..records import shapes
from .arguments import Method, fractions_of
from .boundary import boundary_conditions, require_known_ends
from .engine.layout import Layout
from .engine.start import Start


class Guess(NamedTuple):
    """A guess for ``solve``: states and controls at the stages, and costates at the N + 1 nodes (None: zero).

    Leaves carry the stages or nodes along their leading axis; a step has one stage, with ``Gauss(s, R)`` it has ``s``.
    """

    states: Ambient
    controls: Any
    costates: Any = None

    def __repr__(self) -> str:
        return f"Guess(states={shapes(self.states)}, controls={shapes(self.controls)}, costates={shapes(self.costates)})"


def default_guess(problem: OptimalControlProblem, method: Method, start: Any, end: Any, steps: Any) -> Guess:
    """The guess that ``solve`` begins with: the curve of a retraction from start to end, or, outside its image, a walk to the end.

    The retraction is the method's own; where its curve does not arrive, or in very unequal steps, the default one of the
    manifold. Where the two points are opposite to each other, as attitudes half a turn apart, the walk sets out
    in a direction that is random but always the same: there are several ways round, and this is one of them. Controls rest,
    costates are zero. Raises ``DomainError`` if no curve arrives near the end.
    """
    require_known_ends(problem.manifold, start, end)
    layout, fractions = Layout.of(problem.manifold), fractions_of(steps)
    points = [condition.point for condition in boundary_conditions(problem.manifold, start, end, False)]
    begin, target = (layout.rows(jax.tree.map(np.asarray, point), 0)[None] for point in points)
    places = stage_places(method, fractions)
    states = layout.points(Start(problem.manifold, method.retraction).states(begin, target, places)[0])
    rest = resting_control(problem.controls)
    controls = jax.tree.map(lambda leaf: np.broadcast_to(leaf, (len(places), *np.shape(leaf))), rest)
    return Guess(states, controls, _zero(problem, len(fractions)))


def stage_places(method: Method, fractions: np.ndarray) -> np.ndarray:
    """Times of the stages in fractions of the horizon, from those of the steps."""
    inside = np.array(method.nodes) if isinstance(method, Gauss) else np.array([float(method.theta)])
    starts = np.concatenate([[0.0], np.cumsum(fractions)[:-1]])
    return (starts[:, None] + inside * fractions[:, None]).ravel()


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
    for name, manifold, length in expected:
        _check_arrays(name, getattr(filled, name), manifold, length)
    kinds = Guess(problem.manifold.ambient, problem.controls.ambient, problem.manifold.ambient)
    filled = jax.tree.map(lambda kind, leaf: np.asarray(leaf, kind.dtype), kinds, filled)
    for name, value in at_each(problem.manifold.violations, filled.states).items():
        if not np.max(value) <= default_tolerance():
            worst = f"{name} reaches {np.max(value):.3g}"
            raise InvalidInputError(f"guess: states are not on {problem.manifold}: {worst}, expected 0")
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
