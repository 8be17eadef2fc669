"""Classification of an optimal control problem: regular or singular, and where its singular extremals live."""

from collections import Counter
from dataclasses import replace
from typing import TYPE_CHECKING, Literal, overload

import jax
import jax.numpy as jnp
import numpy as np

from ....manifolds import CotangentBundle, InvalidInputError, NotOnManifoldError
from ....manifolds.numerics.rank import numerical_rank
from ...functions import require_concrete
from ...problem import OptimalControlProblem
from ...results import warn_about_precision
from .classification import Classification, MorseTest, Stratum
from .final import final_equations
from .jets import Pair
from .levels import Level, PointRanks, Signature, point_ranks, summarise
from .points import Points, make_consistent, points_beside, random_starts, select, with_order

if TYPE_CHECKING:
    from ..symbolic import SymbolicClassification

ORDERS = (2, 4, 8, 15)  # of the derivative array: each is compiled only if the one before did not suffice
VANISHING_COSTATE = 1e-6
SAME, FEWEST = 1e-6, 3  # largest difference of directions that are the same, in units, and points that show a piece


@overload
def classify(
    problem: OptimalControlProblem,
    *,
    starts: int = ...,
    seed: int = ...,
    exclude_zero_costate: bool | None = ...,
    near: Pair | None = ...,
    symbolic: Literal[False] = ...,
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
) -> "SymbolicClassification": ...


def classify(
    problem: OptimalControlProblem,
    *,
    starts: int = 20,
    seed: int = 0,
    exclude_zero_costate: bool | None = None,
    near: Pair | None = None,
    symbolic: bool = False,
) -> "Classification | SymbolicClassification":
    """Run the integrability algorithm on Pontryagin's necessary conditions, with controls in the interior of U.

    ``S^0 = S_H``, ``P^k = tau(S^k)``, ``S^{k+1} = T P^k`` intersected with ``S^k``, until nothing changes: pointwise, from
    the ranks of the derivative array of ``dH/du = 0`` at consistent points found from ``starts`` random ones (drawn with
    ``seed``). ``exclude_zero_costate``: leave out extremals with ``p = 0``. By default so where Pontryagin's principle
    excludes them: in abnormal problems, and in those with a terminal cost and no running cost. ``near``, a state ``(q, p)``:
    start from it and from points around it, to see a piece of ``P_f`` too thin for random starts to come to.

    A rank is a statement about the points tested; the record holds the gaps between the singular values, how many points
    agree, and every stratum seen. With ``symbolic`` the algorithm runs in exact algebra instead, for problems on R^n, and
    gives equations, kernel and controls in closed form; it needs SymPy (``pip install "retrax[symbolic]"``). It starts from
    no points: ``starts`` and ``seed`` play no part in it, and ``near`` is refused.

    Raises ``InvalidInputError`` for what is no problem with controls, functions with a kink in them as ``|u|`` or that are finite
    at no start, no number of starts, or what is outside the reach of exact algebra, and ``NotOnManifoldError`` if ``near`` is no
    state.
    """
    require_concrete("classify", problem, near)
    _check(problem, starts, near)
    if symbolic:
        return _symbolic(problem, exclude_zero_costate, near)
    warn_about_precision()
    first = random_starts(problem, ORDERS[0], starts, seed, near)
    homogeneous = problem.abnormal or bool(np.all(first.at.cost_rate == 0))
    exclude = exclude_zero_costate
    if exclude is None:
        exclude = problem.abnormal or (homogeneous and problem.terminal_cost is not None)
    levels, morse, points = _run(first, unit_costate=exclude and homogeneous)
    found = select(points, points.reliable)
    trivial = np.max(np.abs(found.at.costate[:, 1:]), axis=1, initial=0.0) <= VANISHING_COSTATE
    excluded = int(np.sum(trivial)) if exclude else 0
    strata = _strata(select(found, ~trivial) if exclude else found, levels[-1].index)
    return Classification(problem, strata, morse, tuple(levels), excluded, bool(exclude))


def _symbolic(problem: OptimalControlProblem, exclude_zero_costate: bool | None, near: Pair | None) -> "SymbolicClassification":
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
    if not isinstance(starts, int) or starts < 1:
        raise InvalidInputError(f"starts must be a positive number of random starts, got {starts!r}; try 20")
    if problem.controls.dimension == 0:
        raise InvalidInputError(f"the problem has no controls: U is {problem.controls}; give it at least one")
    if near is not None:
        verdict = CotangentBundle(problem.manifold).contains(near)
        if not verdict:
            raise NotOnManifoldError(f"near must be a state (q, p): {verdict.reason}")
    problem.require_no_kink(problem.manifold.random_point(jax.random.key(0)) if near is None else near[0])


def _run(first: Points, unit_costate: bool) -> tuple[list[Level], MorseTest | None, Points]:
    """The levels until ``P^k`` stops around each of its points or none is consistent, and the points at the last of them.

    ``P^k = P^{k-1}`` around a point makes ``S^{k+1}``, the part of ``S^k`` in ``T P^k``, all of ``S^k`` there: nothing
    changes after it. The batch keeps its size, so that one kernel serves all levels up to the order of the array.
    """
    points, levels, morse = first, [], None
    while True:
        level = len(levels)
        if level > points.array.order:
            points = _lengthened(points, first, levels)
        points = _without_crossings(make_consistent(points, level, unit_costate), level, unit_costate)
        reliable = np.flatnonzero(points.reliable)
        ranks = [point_ranks(points, i, level) for i in reliable]
        levels.append(summarise(points, level, ranks))
        _require_finite(points, levels[-1])
        if level == 0 and ranks:
            morse = _morse(select(points, points.consistent))
        settled = level > 0 and all(_new_equations(points, i, r, level) == 0 for i, r in zip(reliable, ranks, strict=True))
        if not ranks or settled:
            return levels, morse, points


def _require_finite(points: Points, level: Level) -> None:
    """Raise if the functions of the problem, or derivatives that a level needs, are finite at none of the points."""
    if not np.isfinite(level.residual):
        q, u = (jax.tree.map(lambda leaf: leaf[0], part) for part in (points.at.z[0], points.at.control))
        raise InvalidInputError(
            f"the problem's functions or their derivatives are not finite at any of {level.tried} points of level {level.index}, "
            f"as at q = {q}, u = {u}: running cost {points.at.cost_rate[0]:.3g}; check their domain, or give near=(q, p), a "
            "state where they are finite"
        )


def _without_crossings(points: Points, level: int, unit_costate: bool) -> Points:
    """The points with those noted as irregular beside which points of ``P^level`` are so, or have other ranks at some level."""
    histories = {i: _signatures(points, i, level) for i in np.flatnonzero(points.reliable)}
    if len(set(histories.values())) < 2:
        return points
    beside, crossing = points_beside(points, level, unit_costate), points.slow.copy()
    for i in set(histories).intersection(np.flatnonzero(beside.consistent)):
        crossing[i] |= beside.slow[i] or _signatures(beside, i, level) != histories[i]
    return replace(points, slow=crossing)


def _signatures(points: Points, index: int, level: int) -> tuple[Signature, ...]:
    """Ranks at a point at all levels up to this one."""
    return tuple(point_ranks(points, index, k).signature for k in range(level + 1))


def _new_equations(points: Points, index: int, ranks: PointRanks, level: int) -> int:
    """By how many dimensions ``P^level`` is smaller than ``P^{level-1}`` around one of its points, of these ``ranks``."""
    return ranks.signature.codimension - point_ranks(points, index, level - 1).signature.codimension


def _lengthened(points: Points, first: Points, levels: list[Level]) -> Points:
    """The points with an array of the next order, in the units that it has at the starts."""
    higher = [order for order in ORDERS if order >= len(levels)]
    if not higher:
        raise InvalidInputError(
            f"the integrability algorithm still finds new conditions after {len(levels)} levels: "
            f"{[level.strata for level in levels]}; check that the functions of the problem are smooth"
        )
    return replace(with_order(points, higher[0]), units=with_order(first, higher[0]).units)


def _morse(points: Points) -> MorseTest:
    """The Morse family test and the test of regularity, at points with ``dH/du = 0``.

    Where these are irregular equations, ``D(dH/du)`` is singular on them though not near them.
    """
    by_state, by_jet = points.matrices(0)
    size = by_jet.shape[1]
    family = [numerical_rank(np.concatenate(pair, axis=1), unit=1.0) for pair in zip(by_state, by_jet, strict=True)]
    hessian = [numerical_rank(matrix, unit=1.0) for matrix in by_jet]
    worst = [min(ranks, key=lambda rank: rank.singular_values[-1]).singular_values for ranks in (family, hessian)]
    return MorseTest(
        count=len(by_jet),
        states=points.at.z,
        controls=points.at.control,
        family=not points.slow.any() and all(rank.rank == size for rank in family),
        family_singular_values=worst[0],
        regular=not points.slow.any() and all(rank.rank == size for rank in hessian),
        hessian_singular_values=worst[1],
        gap=min(rank.gap for rank in [*family, *hessian]),
    )


def _strata(points: Points, last: int) -> tuple[Stratum, ...]:
    """Points clustered by piece, each cluster with the equations through its best conditioned point.

    Pieces differ in their ranks at the last level, in the controls that they determine, or in their tangent spaces.
    """
    final = [point_ranks(points, i, last) for i in range(len(points.residuals))]
    groups: dict[tuple[Signature, tuple[bool, ...]], list[int]] = {}
    for i, ranks in enumerate(final):
        groups.setdefault((ranks.signature, tuple(ranks.determined)), []).append(i)
    told = ([group] if points.slow[group].any() else _told_apart(group, final) for group in groups.values())
    made = [_stratum(points, members, final, last) for pieces in told for members in pieces]
    return tuple(sorted(made, key=lambda stratum: (stratum.signature.codimension, -stratum.count)))


def _told_apart(group: list[int], final: list[PointRanks]) -> list[list[int]]:
    """The pieces that points of equal ranks lie on, as far as their tangent spaces tell them apart.

    The rank of two tangent spaces together is the same for almost all pairs of points of one analytic piece. Where it is not,
    points whose least rank with any other is theirs together are on one piece: a flat one, or one in fewer dimensions than it
    could bend in.
    """
    tangents = [final[i].tangents for i in group]
    joint = np.array([[len(a) if a is b else _joint_rank(a, b) for b in tangents] for a in tangents])
    least, clusters = np.min(joint, axis=1), list[list[int]]()
    for i in range(len(group)):
        for cluster in clusters:
            if joint[i, cluster[0]] == least[i] == least[cluster[0]] < np.max(joint):
                cluster.append(i)
                break
        else:
            clusters.append([i])
    told = [[group[i] for i in cluster] for cluster in clusters if len(cluster) >= FEWEST]
    rest = [i for i in group if not any(i in cluster for cluster in told)]
    return [*told, rest] if rest else told


def _joint_rank(a: np.ndarray, b: np.ndarray) -> int:
    """Rank of two tangent spaces together."""
    return int(np.linalg.matrix_rank(np.concatenate([a, b], axis=1), tol=SAME))


def _stratum(points: Points, members: list[int], final: list[PointRanks], last: int) -> Stratum:
    histories = {i: [*(point_ranks(points, i, level) for level in range(last)), final[i]] for i in members}
    # Few points may lie where pieces cross, or close: the levels are those of most, at the best conditioned of them.
    stops = {i: _stops(history) for i, history in histories.items()}
    ((usual, _),) = Counter(stops.values()).most_common(1)
    index = max((i for i in members if stops[i] == usual), key=lambda i: final[i].gap)
    history, (k_f, base) = histories[index], usual
    ranks, signature = history[-1], history[-1].signature
    point = select(points, index)
    z = jax.tree.map(jnp.asarray, point.at.z)
    return Stratum(
        signature=signature,
        count=len(members),
        flat=all(_joint_rank(ranks.tangents, final[i].tangents) == ranks.tangents.shape[1] for i in members),
        k_f=k_f,
        k_f_base=base,
        determined_at=tuple(_first_level([bool(r.determined[a]) for r in history]) for a in range(point.at.jet.shape[-1])),
        q=z[0],
        p=z[1],
        u=jax.tree.map(jnp.asarray, point.at.control),
        kernel=jax.tree.map(lambda leaf: np.tensordot(ranks.kernel, leaf, 1), point.at.frame),
        states=select(points, np.array(members)).at.z,
        equations=final_equations(points, index, base, history[base]),
        feedback=final_equations(points, index, k_f, history[k_f]),
    )


def _stops(history: list[PointRanks]) -> tuple[int, int]:
    """Levels from which on all ranks, and the codimension, are those of the last."""
    last = history[-1].signature
    k_f = next(k for k, r in enumerate(history) if r.signature == last)
    return k_f, next(k for k, r in enumerate(history) if r.signature.codimension == last.codimension)


def _first_level(determined: list[bool]) -> int | None:
    return determined.index(True) if any(determined) else None
