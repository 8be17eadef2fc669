"""Classification of an optimal control problem: regular or singular, and where its singular extremals live."""

from dataclasses import replace
from typing import TYPE_CHECKING, Literal, overload

import jax
import numpy as np

from ....manifolds import CotangentBundle, InvalidInputError, NotOnManifoldError
from ....manifolds.numerics import ambient as vec
from ....progress import Advance, progress
from ....retractions import default_retraction
from ....tracing import reads_once
from ...problem.initial_controls import resting_control
from ...problem.optimal_control_problem import OptimalControlProblem
from ...problem.user_functions import require_concrete
from ...problem_checks.costs import is_steep
from ...problem_checks.inspection import Inspection
from ...problem_checks.requirements import require_treated, require_values
from ...problem_checks.smoothness.hamiltonian_jumps import Energy, Segments
from ...reporting.result_sentences import warn_about_precision
from ..integrability_result import Signature
from .algorithm_stages import Level, PointRanks, StoppedPoints, point_ranks, summarise
from .classification import Classification, MorseTest
from .derivative_array import Pair
from .random_points import random_starts
from .sample_points import Points, select, with_order
from .search import make_consistent, points_beside
from .strata import Stratum, find_strata

if TYPE_CHECKING:
    from ..symbolic import SymbolicClassification

ARRAY_ORDERS = (2, 4, 8, 15)  # of the derivative array: each is compiled only if the one before did not suffice
MOST_PAIRED = 22  # points between each two of which a jump is looked for


@overload
def classify(
    problem: OptimalControlProblem,
    *,
    starts: int = ...,
    seed: int = ...,
    exclude_zero_costate: bool | None = ...,
    near: Pair | None = ...,
    symbolic: Literal[False] = ...,
    verbose: bool = ...,
) -> Classification: ...


@overload
def classify(
    problem: OptimalControlProblem,
    *,
    starts: int = ...,
    seed: int = ...,
    exclude_zero_costate: bool | None = ...,
    near: Pair | None = ...,
    symbolic: Literal[True],
    verbose: bool = ...,
) -> "SymbolicClassification": ...


@reads_once
def classify(
    problem: OptimalControlProblem,
    *,
    starts: int = 20,
    seed: int = 0,
    exclude_zero_costate: bool | None = None,
    near: Pair | None = None,
    symbolic: bool = False,
    verbose: bool = False,
) -> "Classification | SymbolicClassification":
    r"""Run the integrability algorithm on Pontryagin's necessary conditions, with controls in the interior of U.

    Parameters
    ----------
    problem : OptimalControlProblem
        A problem with controls.
    starts : int
        The number of random starts.
    seed : int
        Their seed.
    exclude_zero_costate : bool, optional
        Whether to leave out extremals with ``p = 0``. By default so where Pontryagin's principle excludes them: in
        abnormal problems, and in problems with a free end, no running cost and a terminal cost with a constant nonzero
        derivative, such as ``q[2]``.
    near : tuple of point and covector, optional
        A state ``(q, p)``: starts are this state and points around it, to find a thin piece of ``P_f``.
    symbolic : bool
        Whether to use exact algebra, for problems on R^n. It needs SymPy, takes no ``near`` and ignores ``starts`` and
        ``seed``.
    verbose : bool
        Whether to show the progress.

    Returns
    -------
    Classification or SymbolicClassification
        The pieces of ``P_f`` with equations, kernel and controls.

    Raises
    ------
    InvalidInputError
        For other arguments, functions with a kink such as ``|u|``, functions without a finite value at the starts, and
        functions outside exact algebra.
    NotOnManifoldError
        If ``near`` is not a state.

    Notes
    -----
    :math:`S^0 = S_H`, :math:`P^k = \tau(S^k)`, :math:`S^{k+1} = TP^k \cap S^k`, until nothing changes. Ranks come from
    the derivative array of :math:`\partial H / \partial u = 0` at consistent points. A rank is a statement about these
    points: the record holds the gaps between singular values, the number of points that agree, and every stratum. An
    interrupt is a ``KeyboardInterrupt`` whose argument is the tuple of the levels until then.

    References
    ----------
    Barbero-Liñán and Martin de Diego, Presymplectic integrators for optimal control problems via retraction maps, 2023.

    Examples
    --------
    >>> line = OptimalControlProblem(Euclidean(1), lambda q, u: u, lambda q, u: u @ u / 2, controls=1)
    >>> classify(line).regular
    True
    """
    require_concrete("classify", problem, near)
    _check(problem, starts, near)
    if symbolic:
        return _symbolic(problem, exclude_zero_costate, near)
    warn_about_precision()
    with np.errstate(all="ignore"):  # functions that overflow are told by values that are not finite
        return _classify(problem, starts, seed, exclude_zero_costate, near, verbose)


def _classify(
    problem: OptimalControlProblem, starts: int, seed: int, exclude: bool | None, near: Pair | None, verbose: bool
) -> Classification:
    first = random_starts(problem, ARRAY_ORDERS[0], starts, seed, near)
    homogeneous = problem.abnormal or float(np.ptp(first.at.cost_rate)) == 0  # a constant is part of no condition
    if exclude is None:
        exclude = problem.abnormal or (homogeneous and is_steep(problem))
    with progress("classify", len(first.slow), "points", verbose) as advance:
        levels, morse, found = _run(first, exclude and homogeneous, advance)
    kept = [item for item in found if not (exclude and item.trivial)]
    strata = find_strata(kept)
    jump = _jump(problem, first, strata)
    return Classification(
        problem, strata, morse, tuple(levels), len(found) - len(kept), bool(exclude), problem._digest(), jump
    )


def _jump(problem: OptimalControlProblem, first: Points, strata: tuple[Stratum, ...]) -> str:
    """Words on a jump of the functions between points of ``P_f``, or starts where it has none; empty if there is
    none."""
    states = [stratum.states[0] for stratum in strata] or [first.at.z[0]]
    q = vec.joined(states)
    count, u = len(jax.tree.leaves(q)[0]), vec.taken(first.at.control, 0)
    i, j = np.triu_indices(min(count, MOST_PAIRED), 1)
    # Costates of the starts: those on P_f may vanish, and hide a jump of the dynamics.
    z = (q, vec.taken(first.at.z[1], np.arange(count) % len(first.slow)))
    before, after = (vec.taken(z, k) for k in (i, j))
    controls = jax.tree.map(lambda a: np.broadcast_to(a, (len(i), *np.shape(a))), u)
    energy = Energy(OptimalControlProblem.hamiltonian, problem, default_retraction(problem.manifold))
    jumps = energy.find_jumps(Segments(before, after, controls))
    return jumps[0].fact("between points that were looked at, near") if jumps else ""


def _symbolic(
    problem: OptimalControlProblem, exclude_zero_costate: bool | None, near: Pair | None
) -> "SymbolicClassification":
    if near is not None:
        raise InvalidInputError("symbolic=True finds the pieces of P_f wherever they are; leave near out")
    try:
        from ..symbolic import classify_symbolically
    except ModuleNotFoundError as error:
        raise InvalidInputError(
            f'symbolic=True needs SymPy, which is not installed ({error}); try pip install "retrax[symbolic]"'
        ) from error
    return classify_symbolically(problem, exclude_zero_costate)


def _check(problem: OptimalControlProblem, starts: int, near: Pair | None) -> None:
    if not isinstance(problem, OptimalControlProblem):
        raise InvalidInputError(f"classify takes an OptimalControlProblem, got {problem!r}")
    require_treated(problem, "classify", "an initial cost")
    if not isinstance(starts, int) or starts < 1:
        raise InvalidInputError(f"starts must be a positive number of random starts, got {starts!r}; try 20")
    if problem.controls.dimension == 0:
        raise InvalidInputError(f"the problem has no controls: U is {problem.controls}; give it at least one")
    if near is not None:
        verdict = CotangentBundle(problem.manifold).contains(near)
        if not verdict:
            raise NotOnManifoldError(f"near must be a state (q, p): {verdict.reason}")
    q = problem.manifold.random_point(jax.random.key(0)) if near is None else near[0]
    require_values(problem)
    Inspection(problem, q, resting_control(problem.controls)).require_smooth()


def _run(
    first: Points, unit_costate: bool, advance: Advance
) -> tuple[list[Level], MorseTest | None, list[StoppedPoints]]:
    """The levels until ``P^k`` stops around each of its points or none is consistent, and the points where it stopped.

    ``P^k = P^{k-1}`` around a point makes ``S^{k+1}``, the part of ``S^k`` in ``T P^k``, all of ``S^k`` there: nothing
    changes after it, and the point goes no further.
    """
    levels = list[Level]()
    try:
        return _through(first, unit_costate, levels, advance)
    except KeyboardInterrupt as interrupt:
        interrupt.args = (tuple(levels),)
        raise


def _through(
    first: Points, unit_costate: bool, levels: list[Level], advance: Advance
) -> tuple[list[Level], MorseTest | None, list[StoppedPoints]]:
    """The result of ``_run`` with ``levels`` extended."""
    points, morse, found = first, None, list[StoppedPoints]()
    while True:
        level = len(levels)
        if level > points.array.order:
            points = _lengthen(points, first, levels)
        points = _mark_unclear(make_consistent(points, level, unit_costate))
        if level == 0 and points.consistent.any():
            morse = _morse(points)
        points = _without_crossings(points, unit_costate)
        # Where equations are irregular at all points, what is read off there is shown, as not reliable.
        reliable = np.flatnonzero(points.regular if found or points.regular.any() else points.consistent)
        histories = _histories(select(points, reliable))
        levels.append(summarise(points, [item.ranks for item in found], [history[-1] for history in histories]))
        _require_finite(points, levels[-1])
        settled = [level > 0 and _new_equations(history) == 0 for history in histories]
        ended = [
            StoppedPoints(select(points, [i]), h)
            for i, h, stops in zip(reliable, histories, settled, strict=True)
            if stops
        ]
        found += ended
        left = np.setdiff1d(np.arange(len(points.slow)), reliable[settled])
        is_last = len(ended) == len(histories)
        advance(len(points.slow) - (0 if is_last else len(left)), f"level {level}")
        if is_last:
            return levels, morse, found
        points = select(points, left)


def _histories(points: Points) -> list[list[PointRanks]]:
    """Ranks at each point of a batch, at all levels up to the level of the batch."""
    if not len(points.slow):
        return []
    levels = [point_ranks(points, level) for level in range(points.level + 1)]
    return [list(history) for history in zip(*levels, strict=True)]


def _signatures(history: list[PointRanks]) -> tuple[Signature, ...]:
    return tuple(ranks.signature for ranks in history)


def _mark_unclear(points: Points) -> Points:
    """The points, with a mark on points at which a rank is not clear or depends on numbers below rounding."""
    histories, rounded = _histories(points), _histories(points.rounded)
    decided = [all(ranks.decided for ranks in history) for history in histories]
    drowned = [_signatures(a) != _signatures(b) for a, b in zip(histories, rounded, strict=True)]
    return replace(points, unclear=~np.array(decided) | drowned | points.at.lost)


def _require_finite(points: Points, level: Level) -> None:
    """Raise if the functions of the problem, or derivatives that a level needs, are finite at none of the points."""
    if not np.isfinite(level.residual):
        q, u = vec.taken((points.at.z[0], points.at.control), 0)
        raise InvalidInputError(
            f"the problem's functions or their derivatives are not finite at any of {level.tried} points of level "
            f"{level.index}, as at q = {q}, u = {u}: running cost {points.at.cost_rate[0]:.3g}; check their domain, or "
            "give near=(q, p), a state where they are finite"
        )


def _without_crossings(points: Points, unit_costate: bool) -> Points:
    """The points, with a mark on points beside which points of ``P^level`` are irregular or have other ranks."""
    reliable = np.flatnonzero(points.regular)
    own = dict(zip(reliable, map(_signatures, _histories(select(points, reliable))), strict=True))
    if len(set(own.values())) < 2:
        return points
    beside, crossing = _mark_unclear(points_beside(points, points.level, unit_costate)), points.slow.copy()
    crossing[reliable] |= (beside.slow & beside.consistent)[reliable]
    compared = reliable[beside.regular[reliable]]
    for i, history in zip(compared, _histories(select(beside, compared)), strict=True):
        crossing[i] |= _signatures(history) != own[i]
    return replace(points, slow=crossing)


def _new_equations(history: list[PointRanks]) -> int:
    """By how many dimensions the last ``P^k`` is smaller than the one before around a point."""
    return history[-1].signature.codimension - history[-2].signature.codimension


def _lengthen(points: Points, first: Points, levels: list[Level]) -> Points:
    """The points with an array of the next order, in the units that it has at the starts."""
    higher = [order for order in ARRAY_ORDERS if order >= len(levels)]
    if not higher:
        raise InvalidInputError(
            f"the integrability algorithm still finds new conditions after {len(levels)} levels: "
            f"{[level.strata for level in levels]}; check that the functions of the problem are smooth"
        )
    longer, sizes = with_order(points, higher[0]), with_order(first, higher[0]).sizes
    return replace(longer, sizes=sizes, slow=points.slow, away=points.away, stiff=points.stiff)


def _morse(points: Points) -> MorseTest:
    """The Morse family test and the test of regularity, at points with ``dH/du = 0`` and clear ranks, if there are any.

    Where these are irregular equations, ``D(dH/du)`` is singular on them though not near them. Where pieces cross, or
    the rank of the form changes, it need not be.
    """
    clear = points.consistent & ~points.unclear
    points = select(points, clear if clear.any() else points.consistent)
    by_state, by_jet = points.matrices(0)
    ranks = point_ranks(points, 0)
    values = [
        np.linalg.svd(matrix, compute_uv=False) for matrix in (np.concatenate([by_state, by_jet], axis=2), by_jet)
    ]
    worst = [batch[np.argmin(batch[:, -1])] for batch in values]
    return MorseTest(
        count=len(by_jet),
        states=points.at.z,
        controls=points.at.control,
        family=not points.slow.any() and all(r.signature.codimension == r.signature.free_controls for r in ranks),
        family_singular_values=worst[0],
        regular=not points.slow.any() and all(r.signature.free_controls == 0 for r in ranks),
        hessian_singular_values=worst[1],
        gap=min(r.gap for r in ranks),
    )
