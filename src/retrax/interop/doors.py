"""Our manifolds as those of pymanopt and geomstats, theirs as ours; our problems as nonlinear programs for CasADi's
solvers."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from ..integrators import Free, Guess, OptimalControlProblem
from ..manifolds import InvalidInputError, Manifold, Metric
from ..manifolds.manifold import same_manifold
from ..retractions import DiscretizationMap, Gauss, Retraction, default_retraction
from .conventions import Conventions
from .counterpart import Counterpart
from .geometry import Geometry
from .isolated_import import import_peer
from .metrics import natural_metric

if TYPE_CHECKING:
    from .discrete_problem import DiscreteProblem


def to_pymanopt(
    manifold: Manifold,
    retraction: Retraction | None = None,
    metric: Metric | None = None,
    conventions: Conventions | None = None,
) -> Any:
    """A manifold with a retraction (default: ``default_retraction``) as a pymanopt manifold, for pymanopt's optimisers.

    Points, tangent vectors and arguments are pymanopt's: tangent vectors of SO(n) are skew factors, points of a product
    are lists, flat however the product is nested. Gradients and Hessians are those of ``metric``, by default the usual
    one: affine-invariant on SPD, Lorentz on hyperbolic space, left-invariant on SL, else that of the ambient space.
    ``to_pymanopt(*from_pymanopt(space))`` is ``space`` on our code.

    Raises ``InvalidInputError`` if the retraction or the metric belongs to another manifold.
    """
    module = import_peer(".pymanopt")
    geometry = _geometry(manifold, retraction, metric, conventions, module.conventions_of)
    return module.RetraxManifold(geometry, module.typical_distance(manifold))


def from_pymanopt(space: Any) -> Counterpart:
    """A pymanopt manifold as ours: ``manifold, retraction, metric, conventions``.

    Manifolds that we have become ours, with the retraction that the given one was made with. Others keep pymanopt's
    functions, which run on the host: derivatives are differences, right to about 1e-8 or NaN, and slow. Raises
    ``InvalidInputError`` for any other that is not an embedded manifold of real arrays (a quotient, complex entries,
    points of several arrays).
    """
    return import_peer(".pymanopt").counterpart(space)


def to_geomstats(
    manifold: Manifold,
    retraction: Retraction | None = None,
    metric: Metric | None = None,
    conventions: Conventions | None = None,
) -> Any:
    """A manifold as a geomstats space with a metric, for geomstats' learning algorithms.

    Arguments come in geomstats' order, leading axes are batches, and a point of several arrays is one vector of their
    entries. ``metric`` is by default the usual one, as in ``to_pymanopt``; where no closed form of its exponential map
    is known, geodesics are integrated. Raises ``InvalidInputError`` if the retraction or the metric belongs to another
    manifold.
    """
    module = import_peer(".geomstats")
    return module.RetraxSpace(_geometry(manifold, retraction, metric, conventions, module.conventions_of))


def from_geomstats(space: Any) -> Counterpart:
    """A geomstats space as ours: ``manifold, retraction, metric, conventions``.

    Spaces that we have become ours, with the default retraction. Others keep geomstats' tangent projection and
    exponential map, which run on the host: derivatives are differences, right to about 1e-8 or NaN, and slow. Raises
    ``InvalidInputError`` for one that is not an embedded manifold of real arrays.
    """
    return import_peer(".geomstats").counterpart(space)


def to_casadi(
    problem: OptimalControlProblem,
    method: DiscretizationMap | Gauss,
    start: Any,
    end: Any,
    horizon: float | Free,
    steps: Any,
    guess: Guess | None = None,
    parameters: Any = None,
) -> "DiscreteProblem":
    """The discrete problem that ``solve`` with these arguments solves, as a nonlinear program for ``casadi.nlpsol``.

    The functions are the same, written in the coordinates of the ambient space: points have the equations of their
    manifold as constraints, and nodes are where ends meet. So it has no chart that could be left, and no two unknowns
    for one attitude. What is returned has the program in ``nlp``, its guess and bounds in ``arguments``, and
    ``guess(found)`` for the way back::

        discrete = to_casadi(problem, method, start, end, horizon, steps)
        found = casadi.nlpsol("solver", "ipopt", discrete.nlp)(**discrete.arguments)
        solution = solve(problem, method, start, end, horizon, steps, guess=discrete.guess(found))

    Raises ``InvalidInputError`` or ``NotOnManifoldError`` for arguments that ``solve`` would not take, and
    ``InvalidInputError`` for a manifold of which no independent equations are known; ``NotTraceableError`` where a
    function has no scalar operations.
    """
    from .discrete_problem import posed

    return posed(problem, method, (start, end), horizon, steps, guess, parameters)


def _geometry(
    manifold: Manifold,
    retraction: Retraction | None,
    metric: Metric | None,
    conventions: Conventions | None,
    conventions_of: Callable[[Manifold], Conventions],
) -> Geometry:
    if not isinstance(manifold, Manifold):
        raise InvalidInputError(f"expected a manifold of retrax, got {manifold!r}; try SO(3)")
    retraction = default_retraction(manifold) if retraction is None else retraction
    metric = natural_metric(manifold) if metric is None else metric
    if not isinstance(retraction, Retraction):
        raise InvalidInputError(
            f"expected a retraction of {manifold}, got {retraction!r}; a family takes it: Cayley(manifold)"
        )
    if not isinstance(metric, Metric):
        raise InvalidInputError(f"expected a metric of {manifold}, got {metric!r}; try EmbeddedMetric(manifold)")
    for name, given in (("retraction", retraction), ("metric", metric)):
        if not same_manifold(given.manifold, manifold):
            raise InvalidInputError(f"the {name} acts on {given.manifold}, expected {manifold}")
    return Geometry(manifold, retraction, metric, conventions_of(manifold) if conventions is None else conventions)
