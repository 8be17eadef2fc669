"""Controls that are held between samples: a problem in discrete time."""

from collections.abc import Callable
from functools import wraps
from typing import Any, NamedTuple, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ...manifolds import Euclidean, InvalidInputError
from ...manifolds.bundles import same_manifold
from ...manifolds.numerics import ambient as vec
from ...manifolds.numerics.ambient import Ambient, is_count, is_finite_number
from ...retractions import ProductRetraction, Retraction, default_retraction
from ..problem.argument_errors import require_known_options
from ..problem.explicit_time import argument_names, with_signature
from ..problem.optimal_control_problem import OptimalControlProblem
from ..problem.path_constraints import Inequalities
from ..problem.sampling import Sampling
from ..reporting.text import brief
from .explicit_runge_kutta import RK4, chart_rate

STATE, ENDS = (0, 1, 4), 3  # kinds of functions: of one state, of the states at both ends
BOUNDED = "control_bounds of held controls"


@require_known_options
def hold_controls(
    problem: OptimalControlProblem,
    sample_time: float,
    order: int = 0,
    rate_limits: Any = None,
    substeps: int = 1,
    retraction: Retraction | None = None,
) -> OptimalControlProblem:
    r"""The problem in discrete time, with controls that a digital computer holds between its samples.

    Parameters
    ----------
    problem : OptimalControlProblem
        The problem in continuous time.
    sample_time : float
        The time ``h`` between two samples, in the unit of the horizon.
    order : int
        0 for a control that is constant between samples, 1 for a control that is linear and continuous.
    rate_limits : float or array_like of shape (m,), optional
        The largest change of a control in a unit of time; between two samples it changes by at most ``rate_limits h``.
    substeps : int
        The number of steps of the Runge-Kutta method between two samples.
    retraction : Retraction, optional
        The retraction of the charts; by default ``default_retraction(problem.manifold)``.

    Returns
    -------
    OptimalControlProblem
        A problem for ``solve`` and ``Solver`` with one step for each sample. With ``order=0`` and no rate limits it has
        the states and controls of the problem. Otherwise its states are pairs ``(q, w)``, with the control ``w`` at the
        sample, or before it with ``order=0``, and its controls are the rates ``v`` of this control.

    Raises
    ------
    InvalidInputError
        For other arguments; for rates of controls that are not in R^m; for periodic ends with rates.

    Notes
    -----
    The Runge-Kutta method of order 4 carries the state, in the chart of ``R`` around ``q_k``, and the integral of the
    running cost over one sample. The coordinates ``c`` of the next sample are one step of the Euler map, ``q_{k+1} =
    R(q_k, c)``, so the discrete problem is solved without a further error.

    The control at a time ``t`` after a sample is :math:`w + h v` with ``order=0`` and :math:`w + t v` with ``order=1``,
    and the next sample has :math:`w + h v`. Constraints hold at each sample but the last, node constraints at all.

    References
    ----------
    Franklin, Powell, Workman, Digital Control of Dynamic Systems, 1998, 4.3.

    Examples
    --------
    >>> line = OptimalControlProblem(Euclidean(1), lambda q, u: u, lambda q, u: u @ u / 2, controls=1)
    >>> held = hold_controls(line, 0.5, order=1, rate_limits=2.0)
    >>> print(held.manifold, held.control_bounds[1])
    R^1 x R^1 [2.]
    """
    chart = _require(problem, sample_time, order, substeps, retraction)
    sample = _Sample(problem, chart, float(sample_time), substeps)
    if order == 0 and rate_limits is None:
        held = sample.functions(lambda q, u: (q, lambda t: u), lambda velocity, u: velocity)
        return problem._with_arguments(**held, sampling=Sampling(sample.time, chart))
    return _with_rates(problem, sample, order, _rates(problem, rate_limits))


@final
class _Sample(NamedTuple):
    """The motion of a problem between two samples, in a chart around the state at the first one."""

    problem: OptimalControlProblem
    retraction: Retraction
    time: float
    substeps: int

    def functions(self, split: Callable[..., Any], join: Callable[..., Any]) -> dict[str, Callable[..., Any]]:
        """Dynamics and running cost of the discrete problem.

        ``split(x, v)``: the state of the problem, and its control as a function of the time after the sample;
        ``join(velocity, v)``: the tangent vector at ``x``.
        """

        def dynamics(x: Ambient, v: Ambient, *rest: Any) -> Ambient:
            q, signal = split(x, v)
            c, _ = self._after(q, signal, rest)
            return join(vec.combine(self.problem.manifold.basis(q), c / self.time), v)

        def running_cost(x: Ambient, v: Ambient, *rest: Any) -> Array:
            q, signal = split(x, v)
            return self._after(q, signal, rest)[1] / self.time

        problem = self.problem
        names = argument_names(2, problem.time_dependent, problem.takes_parameters)
        return {
            "dynamics": with_signature(problem.dynamics, names, dynamics),
            "running_cost": with_signature(problem.running_cost, names, running_cost),
        }

    def _after(self, q: Ambient, signal: Callable[[float], Ambient], rest: tuple[Any, ...]) -> tuple[Array, Array]:
        """The coordinates at the next sample in the chart around ``q``, and the cost until then."""
        (matrix, weights, nodes), h = RK4, self.time / self.substeps
        start = rest[0] if self.problem.time_dependent else 0.0
        bound = self.problem.with_parameters(rest[-1]) if self.problem.takes_parameters else self.problem
        # Traced once for all stages.
        rates_at = jax.jit(lambda c, u, t: self._rates(q, c, u, bound.at_time(start + t)))
        c, cost = jnp.zeros(self.problem.manifold.dimension), jnp.zeros(())
        for begun in h * np.arange(self.substeps):
            slopes, rates = [], []
            for row, t in zip(matrix, begun + h * nodes, strict=True):
                stage = c + h * sum(a * slope for a, slope in zip(row, slopes, strict=False) if a)
                slope, rate = rates_at(stage, signal(t), t)
                slopes.append(slope)
                rates.append(rate)
            c, cost = c + h * weights @ jnp.stack(slopes), cost + h * weights @ jnp.stack(rates)
        return c, cost

    def _rates(self, q: Ambient, c: Array, u: Ambient, now: OptimalControlProblem) -> tuple[Array, Array]:
        """The derivatives of the coordinates and of the cost."""
        point = self.retraction.chart(q, self.retraction.frame(q), c)
        return chart_rate(self.retraction, q, c, now.velocity(point, u)), now.cost_rate(point, u)


def _with_rates(
    problem: OptimalControlProblem, sample: _Sample, order: int, rates: np.ndarray
) -> OptimalControlProblem:
    """The discrete problem with states ``(q, w)`` and the rates of ``w`` as controls."""
    h, limits = sample.time, problem._limits

    def split(x: Ambient, v: Array) -> tuple[Ambient, Callable[[float], Array]]:
        q, w = x
        return q, lambda t: w + (t if order else h) * v

    def change(function: Callable[..., Any], kind: int) -> Callable[..., Any]:
        def call(*given: Any) -> Any:
            if kind in STATE:
                return function(given[0][0], *given[1:])
            if kind == ENDS:
                return function(given[0][0], given[1][0], *given[2:])
            q, signal = split(*given[:2])
            return function(q, signal(0.0), *given[2:])

        return wraps(function)(call)

    paired = problem._map_functions(change, problem.time_dependent)
    along, at_samples = dict(paired.constraints), dict(paired.node_constraints)
    at_node, at_stage = (argument_names(kind, problem.time_dependent, False) for kind in (1, 2))
    if any(limits.bounded.values()):
        outside = Inequalities(limits.lower, limits.upper).values
        if order:
            at_samples[BOUNDED] = with_signature(outside, at_node, lambda x, *rest: outside(*x))
        else:  # the control before the first sample has acted already
            along[BOUNDED] = with_signature(outside, at_stage, lambda x, v, *rest: outside(x[0], x[1] + h * v))
    bounds = (-rates, rates) if np.isfinite(rates).any() else None
    given: Any = {"constraints": Inequalities.of(bounds, along, at_samples, problem.controls)}
    given |= sample.functions(split, lambda velocity, v: (velocity, v))
    steered = ProductRetraction(sample.retraction, default_retraction(problem.controls))
    return paired._with_arguments(
        manifold=steered.manifold,
        labels=problem.quantities.with_rates(),
        sampling=Sampling(h, steered),
        **given,
    )


def _rates(problem: OptimalControlProblem, given: Any) -> np.ndarray:
    """The limits of the rates, infinite without any; raises unless the problem has rates."""
    if not isinstance(problem.controls, Euclidean):
        raise InvalidInputError(f"the controls lie in {problem.controls}; expected R^m, where rates are vectors")
    if problem._boundary.turn is not None:
        raise InvalidInputError(
            "the problem is periodic, and a control with rates has a value at both ends; expected a problem that is "
            'not; try boundary_constraints={"closed": lambda first, last: ...}'
        )
    if given is None:
        return np.full(problem.controls.shape, np.inf)
    rates = np.asarray(given, float)
    if rates.shape not in ((), problem.controls.shape) or not np.all(rates > 0):
        raise InvalidInputError(
            f"rate_limits must be a positive number or an array of shape {problem.controls.shape}, got {brief(given)}"
        )
    return np.broadcast_to(rates, problem.controls.shape)


def _require(problem: Any, sample_time: Any, order: Any, substeps: Any, retraction: Any) -> Retraction:
    """The retraction of the charts; raises for wrong arguments."""
    if not isinstance(problem, OptimalControlProblem):
        raise InvalidInputError(f"hold_controls takes an OptimalControlProblem, got {brief(problem)}")
    if not (is_finite_number(sample_time) and sample_time > 0):
        raise InvalidInputError(f"sample_time must be a positive finite time, got {sample_time!r}; try 0.1")
    if order not in (0, 1):
        raise InvalidInputError(
            f"order must be 0 for constant controls between samples, or 1 for linear ones, got {order!r}"
        )
    if not is_count(substeps):
        raise InvalidInputError(f"substeps must be a whole number of at least 1, got {substeps!r}")
    if problem.sampling is not None:
        raise InvalidInputError("the controls of the problem are held already; expected a problem in continuous time")
    chart = default_retraction(problem.manifold) if retraction is None else retraction
    if not (isinstance(chart, Retraction) and same_manifold(chart.manifold, problem.manifold)):
        raise InvalidInputError(f"retraction must be a retraction of {problem.manifold}, got {brief(retraction)}")
    return chart
