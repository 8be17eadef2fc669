"""Conversions of manifolds to and from pymanopt and geomstats, and of problems to nonlinear programs for CasADi."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from ..integrators import Free, Guess, OptimalControlProblem
from ..manifolds import InvalidInputError, Manifold, Metric
from ..manifolds.bundles import same_manifold
from ..retractions import CollocationMethod, DiscretizationMap, Retraction, default_retraction
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
    """A manifold with a retraction as a pymanopt manifold, for the optimizers of pymanopt.

    Parameters
    ----------
    manifold : Manifold
        The manifold.
    retraction : Retraction, optional
        By default ``default_retraction(manifold)``.
    metric : Metric, optional
        The metric of gradients and Hessians. By default affine-invariant on SPD, Lorentz on hyperbolic space,
        left-invariant on SL, and otherwise the ambient metric.
    conventions : Conventions, optional
        The form of points and tangent vectors; by default the form of pymanopt.

    Returns
    -------
    pymanopt manifold
        The manifold; ``to_pymanopt(*from_pymanopt(space))`` is ``space`` on the code of retrax.

    Raises
    ------
    InvalidInputError
        If the retraction or the metric belongs to another manifold.

    Notes
    -----
    Points, tangent vectors and arguments follow pymanopt: tangent vectors of SO(n) are skew factors, and points
    of a product are flat lists.
    """
    module = import_peer(".pymanopt")
    geometry = _geometry(manifold, retraction, metric, conventions, module.conventions_of)
    return module.RetraxManifold(geometry, module.typical_distance(manifold))


def from_pymanopt(space: Any) -> Counterpart:
    """A pymanopt manifold as a manifold of retrax, with retraction, metric and conventions.

    Parameters
    ----------
    space : pymanopt manifold
        An embedded manifold of real arrays.

    Returns
    -------
    Counterpart
        ``manifold, retraction, metric, conventions``.

    Raises
    ------
    InvalidInputError
        For a quotient, complex entries, or points of several arrays that retrax does not have.

    Notes
    -----
    Manifolds that retrax has become its own, with the retraction of the given manifold. Other manifolds use the
    functions of pymanopt on the host. Their derivatives are differences, accurate to about 1e-8 or NaN, and slow.
    """
    return import_peer(".pymanopt").counterpart(space)


def to_geomstats(
    manifold: Manifold,
    retraction: Retraction | None = None,
    metric: Metric | None = None,
    conventions: Conventions | None = None,
) -> Any:
    """A manifold as a geomstats space with a metric, for the learning algorithms of geomstats.

    Parameters
    ----------
    manifold : Manifold
        The manifold.
    retraction : Retraction, optional
        By default ``default_retraction(manifold)``.
    metric : Metric, optional
        By default as in ``to_pymanopt``. Geodesics are integrated if there is no closed form of the exponential map.
    conventions : Conventions, optional
        The form of points and tangent vectors; by default the form of geomstats.

    Returns
    -------
    geomstats space
        The space. Arguments have the order of geomstats, leading axes are batches, and a point of several arrays is one
        vector.

    Raises
    ------
    InvalidInputError
        If the retraction or the metric belongs to another manifold.
    """
    module = import_peer(".geomstats")
    return module.RetraxSpace(_geometry(manifold, retraction, metric, conventions, module.conventions_of))


def from_geomstats(space: Any) -> Counterpart:
    """A geomstats space as a manifold of retrax, with retraction, metric and conventions.

    Parameters
    ----------
    space : geomstats space
        An embedded manifold of real arrays; ``InvalidInputError`` for another one.

    Returns
    -------
    Counterpart
        ``manifold, retraction, metric, conventions``.

    Notes
    -----
    Spaces that retrax has become its own, with the default retraction. Other spaces use the tangent projection and the
    exponential map of geomstats on the host. Their derivatives are differences, accurate to about 1e-8 or NaN, and
    slow.
    """
    return import_peer(".geomstats").counterpart(space)


def to_casadi(
    problem: OptimalControlProblem,
    method: DiscretizationMap | CollocationMethod,
    start: Any,
    end: Any,
    horizon: float | Free,
    steps: Any,
    guess: Guess | None = None,
    parameters: Any = None,
) -> "DiscreteProblem":
    """The discrete problem of ``solve`` as a nonlinear program for ``casadi.nlpsol``.

    Parameters
    ----------
    problem, method, start, end, horizon, steps, guess, parameters
        As in ``solve``, in this order.

    Returns
    -------
    DiscreteProblem
        The program ``nlp``, its guess and bounds ``arguments``, and ``guess(found)`` for the way back.

    Raises
    ------
    InvalidInputError, NotOnManifoldError
        For arguments that ``solve`` does not accept, and for a manifold without known independent equations.
    NotTraceableError
        If a function has no scalar operations.

    Notes
    -----
    The functions are the same, in the coordinates of the ambient space. Points have the equations of their manifold as
    constraints, and nodes are where ends meet. A program without charts has one unknown for each attitude::

        discrete = to_casadi(problem, method, start, end, horizon, steps)
        found = casadi.nlpsol("solver", "ipopt", discrete.nlp)(**discrete.arguments)
        solution = solve(problem, start, end, horizon, method=method, steps=steps, guess=discrete.guess(found))
    """
    from .discrete_problem import transcribe

    return transcribe(problem, method, (start, end), horizon, steps, guess, parameters)


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
