"""The pieces of ``P_f``, told apart by the points at which the algorithm stopped."""

from collections import Counter
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from ....manifolds.numerics import ambient as vec
from ....manifolds.numerics.ambient import Ambient
from ..integrability_result import Signature
from .affine_hulls import APART, FEWEST_POINTS, SAME_DIRECTION, AffineHull, PieceEquations, piece_equations
from .algorithm_stages import PointRanks, StoppedPoints
from .final_equations import FinalEquations, final_equations


@dataclass(frozen=True, eq=False)
class Stratum:
    """A piece of ``P_f`` with constant ranks, found at ``count`` of the points.

    Attributes
    ----------
    signature : Signature
        Codimension, free controls, rank of the form.
    count : int
        The number of points on it.
    flat : bool
        Whether its tangent spaces are the same at all points.
    k_f, k_f_base : int
        The levels at which ``S`` and ``P`` stop changing.
    determined_at : tuple of int or None
        For each control component the level that determines it; None if it is free.
    q, p, u : point, covector, control
        A point of the piece, and a control there.
    kernel : pair
        Basis of the kernel of ``omega_f`` at the point, leaves ``(k, *leaf)`` of pairs ``(dq, dp)``.
    states : pair
        All its points, leaves ``(count, *leaf)`` of pairs ``(q, p)``.
    equations : FinalEquations
        Equations, which may vanish on other pieces too.
    piece : PieceEquations or None
        Equations of this piece alone; None if it lies in no affine space of its own.
    feedback : FinalEquations
        The equations that determine the controls.
    """

    signature: Signature
    count: int
    flat: bool
    k_f: int
    k_f_base: int
    determined_at: tuple[int | None, ...]
    q: Ambient
    p: Ambient
    u: Ambient
    kernel: Ambient
    states: Ambient
    equations: FinalEquations
    piece: PieceEquations | None
    feedback: FinalEquations

    @property
    def codimension(self) -> int:
        """The number of independent equations in ``T*Q``."""
        return self.signature.codimension

    @property
    def dimension(self) -> int:
        """The dimension of the piece: rank of the form plus dimension of its kernel."""
        return self.rank + len(jax.tree.leaves(self.kernel)[0])

    @property
    def rank(self) -> int:
        """The rank of ``omega_f``."""
        return self.signature.form_rank

    @property
    def free_controls(self) -> int:
        """The number of free controls."""
        return self.signature.free_controls


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
