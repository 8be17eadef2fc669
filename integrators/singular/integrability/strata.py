"""The pieces of ``P_f``, told apart by the points at which the algorithm stopped."""

from collections import Counter
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ....manifolds.numerics import ambient as vec
from ..integrability_result import Signature
from .affine_hulls import APART, FEWEST_POINTS, SAME_DIRECTION, AffineHull, piece_equations
from .algorithm_stages import PointRanks
from .classification import Stratum
from .final_equations import final_equations
from .sample_points import Points

VANISHING_COSTATE = 1e-6


class StoppedPoints(NamedTuple):
    """A point around which ``P^k`` stopped, in a batch of its own, and its ranks at all levels."""

    points: Points
    history: list[PointRanks]

    @property
    def ranks(self) -> PointRanks:
        """At the last level."""
        return self.history[-1]

    @property
    def trivial(self) -> bool:
        """Whether the costate vanishes."""
        sizes = self.points.sizes
        return bool(np.max(np.abs(self.points.at.costate) * sizes.lengths) <= VANISHING_COSTATE * sizes.action)


def find_strata(found: list[StoppedPoints]) -> tuple[Stratum, ...]:
    """Points clustered by piece, each cluster with the equations through its best conditioned point.

    Pieces differ in their ranks at the last level, in the controls that they determine, or in their tangent spaces.
    """
    groups: dict[tuple[Signature, tuple[bool, ...]], list[StoppedPoints]] = {}
    for item in found:
        groups.setdefault((item.ranks.signature, tuple(item.ranks.determined)), []).append(item)
    told = ([group] if any(item.points.slow for item in group) else _separate(group) for group in groups.values())
    made = [_stratum(members) for pieces in told for members in pieces]
    return tuple(sorted(made, key=lambda stratum: (stratum.signature.codimension, -stratum.count)))


def _separate(group: list[StoppedPoints]) -> list[list[StoppedPoints]]:
    """The pieces that points of equal ranks lie on, as far as their tangent spaces tell them apart.

    The rank of two tangent spaces together is the same for almost all pairs of points of one analytic piece. Where it
    is not, points whose least rank with any other is theirs together are on one piece: a flat one, or one in fewer
    dimensions than it could bend in. Few points show no piece: beside a single one, unless that has most, they are
    where it is flat to rounding.
    """
    joint, clear = _joint_ranks([item.ranks.tangents for item in group])
    if not clear:
        return [group]
    least, clusters = np.min(joint, axis=1), list[list[int]]()
    for i in range(len(group)):
        for cluster in clusters:
            if joint[i, cluster[0]] == least[i] == least[cluster[0]] < np.max(joint):
                cluster.append(i)
                break
        else:
            clusters.append([i])
    told = [cluster for cluster in clusters if len(cluster) >= FEWEST_POINTS]
    if sum(map(len, told)) <= len(group) / 2 and len(told) < 2:
        return [group]
    rest = [i for i in range(len(group)) if not any(i in cluster for cluster in told)]
    return [[group[i] for i in cluster] for cluster in (*told, rest) if cluster]


def _joint_ranks(tangents: list[np.ndarray]) -> tuple[np.ndarray, bool]:
    """Ranks of pairs of tangent spaces together, and whether all are clear; of one with itself more than of any
    pair."""
    count, (height, _) = len(tangents), tangents[0].shape
    joint, (i, j) = np.full((count, count), height), np.triu_indices(count, 1)
    if not len(i):
        return joint, True
    spaces = np.array(tangents)
    values = np.linalg.svd(np.concatenate([spaces[i], spaces[j]], axis=2), compute_uv=False)
    joint[i, j] = joint[j, i] = np.sum(values > SAME_DIRECTION, axis=1)
    return joint, not np.any((values > SAME_DIRECTION) & (values <= APART))


def _stratum(members: list[StoppedPoints]) -> Stratum:
    # Few points may lie where pieces cross, or close: the levels are those of most, at the best conditioned of them.
    ((usual, _),) = Counter(_stops(item.history) for item in members).most_common(1)
    (points, history), (k_f, base) = (
        max((m for m in members if _stops(m.history) == usual), key=lambda m: m.ranks.gap),
        usual,
    )
    ranks, tangents = history[-1], np.array([item.ranks.tangents for item in members])
    z, u, frame = jax.tree.map(jnp.asarray, vec.taken((points.at.z, points.at.control, points.at.frame), 0))
    equations, hull = final_equations(points, base, history[base]), AffineHull.of(members)
    return Stratum(
        signature=ranks.signature,
        count=len(members),
        flat=bool(np.all(np.abs(tangents - ranks.tangents @ (ranks.tangents.T @ tangents)) <= SAME_DIRECTION)),
        k_f=k_f,
        k_f_base=base,
        determined_at=tuple(
            _first_level([bool(r.determined[a]) for r in history]) for a in range(points.at.jet.shape[-1])
        ),
        q=z[0],
        p=z[1],
        u=u,
        kernel=jax.tree.map(lambda leaf: np.tensordot(ranks.kernel, leaf, 1), frame),
        states=vec.joined([item.points.at.z for item in members]),
        equations=equations,
        piece=None if hull is None else piece_equations(hull, equations, points),
        feedback=final_equations(points, k_f, history[k_f]),
    )


def _stops(history: list[PointRanks]) -> tuple[int, int]:
    """Levels from which on all ranks, and the codimension, equal the last values."""
    last = history[-1].signature
    k_f = next(k for k, r in enumerate(history) if r.signature == last)
    return k_f, next(k for k, r in enumerate(history) if r.signature.codimension == last.codimension)


def _first_level(determined: list[bool]) -> int | None:
    return determined.index(True) if any(determined) else None
