"""Several extremals of one problem, found from drawn guesses."""

from functools import partial
from typing import Any

import jax
import numpy as np

from ....manifolds import Euclidean, InvalidInputError, Manifold, Product
from ....manifolds.numerics.ambient import Ambient
from ...problem.argument_errors import require_known_options
from ...problem.free_quantities import Free, is_free
from ...problem.point_layout import PointLayout
from ...problem.user_functions import require_concrete
from ...reporting.text import brief
from ..guess import DefaultGuess, Guess
from ..inputs.boundary_data import BoundaryDataReader
from ..solution.batch import Solutions
from ..solver import Solver

WAYPOINTS = 3  # at most


@require_known_options
def multistart(
    solver: Solver,
    start: Any,
    end: Any,
    horizon: Any,
    count: int = 24,
    seed: int = 0,
    parameters: Any = None,
    tolerance: float | None = None,
    max_iterations: int = 100,
) -> Solutions:
    """The extremals that several guesses lead to, in one batch: converged members first, the lowest cost first of
    all.

    Parameters
    ----------
    solver : Solver
        The solver of a regular problem.
    start, end, horizon
        As in ``solver.solve``.
    count : int
        The number of guesses.
    seed : int
        The seed of the random points.
    parameters, tolerance, max_iterations
        As in ``solver.solve``.

    Returns
    -------
    Solutions
        The batch: ``[0]`` is the best, ``distinct`` the number of different extremals. Nothing is raised if no guess
        converges: read ``success``.

    Raises
    ------
    InvalidInputError
        For other arguments.

    Notes
    -----
    The first guess is the default guess. The others pass through one to three random points of the manifold, with
    controls at rest. In flat factors the points are near both ends, relative to the distance and size of the ends. The
    least cost is an upper bound of the optimum, not a proof of it.

    References
    ----------
    Rinnooy Kan, Timmer, Stochastic global optimization methods, Math. Program. 39, 1987.
    """
    require_concrete("multistart", start, end, horizon, parameters)
    if not isinstance(solver, Solver):
        raise InvalidInputError(f"multistart takes a Solver, got {brief(solver)}; try Solver(problem, method, steps)")
    for name, value, least in (("count", count, 1), ("seed", seed, 0)):
        if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < least:
            raise InvalidInputError(f"{name} must be a whole number of at least {least}, got {value!r}")
    given = jax.tree.map(partial(_repeat, count), parameters)
    guesses = _guesses(solver, start, end, count, seed)
    options = {"tolerance": tolerance, "max_iterations": max_iterations}
    found = solver.solve_many(start, end, horizon, guesses, given, **options)
    return Solutions.of(sorted(found, key=lambda one: (not one.success, one.cost)))


def _repeat(count: int, leaf: Any) -> Any:
    if is_free(leaf):
        return Free(*(_repeat(count, value) for value in (leaf.guess, leaf.lower, leaf.upper)))
    return np.broadcast_to(leaf, (count, *np.shape(leaf)))


def _guesses(solver: Solver, start: Any, end: Any, count: int, seed: int) -> list[Guess]:
    """The guesses."""
    problem, steps = solver.problem, solver.fractions
    ends, layout = BoundaryDataReader.of(problem).ends(start, end, batched=False), PointLayout.of(problem.manifold)
    ends.require_known(start)
    first, last = layout.points(ends.start[0]), layout.points(ends.end[0])
    default, guesses = DefaultGuess(problem, solver.method), list[Guess]()
    for k in range(count):
        draw = np.random.default_rng([seed, k])
        between = [_point(problem.manifold, first, last, draw) for _ in range(1 + (k - 1) % WAYPOINTS if k else 0)]
        rows = np.concatenate([ends.start, *(layout.rows(point, 0)[None] for point in between), ends.end])
        guesses.append(default.through(rows, np.linspace(0.0, 1.0, len(rows)), steps))
    return guesses


def _point(manifold: Manifold, first: Any, last: Any, draw: np.random.Generator) -> Ambient:
    """A drawn point; in flat factors around two points."""
    if isinstance(manifold, Product):
        return tuple(_point(*parts, draw) for parts in zip(manifold.factors, first, last, strict=True))
    if isinstance(manifold, Euclidean):
        size = np.max(np.abs(last - first), initial=0.0) + np.max(np.abs([first, last]), initial=0.0)
        return (first + last) / 2 + size * draw.standard_normal(np.shape(first))
    return jax.tree.map(np.asarray, manifold.random_point(jax.random.key(int(draw.integers(2**31)))))
