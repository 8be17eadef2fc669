"""Condensing of Gauss's method: chart velocities and the multipliers of its points are eliminated step by step.

A step has the unknowns ``x``, ``nu_1..nu_s``, ``u_1..u_s`` and the equations ``d_i = 0`` of its points, with
multipliers ``lambda_i``. Newton's equations of the latter give ``dnu = N w + nu_0`` with ``w = (dx, du)``; put into the
others, they leave a ``BlockSystem`` in ``w``, whose matrix has ``s n`` positive and as many negative eigenvalues less
for each step.
"""

from collections.abc import Iterable
from typing import NamedTuple, final

import numpy as np
from jaxtyping import Float

from ....aligned import aligned, scratch
from ....compute.threads import in_threads
from ..transcription.functions.steps import Tableau
from .arrays import plain, whole
from .elimination import BlockSystem


@final
class Points(NamedTuple):
    """At each point, in ``(dx, dxi, dnu, du)``, ``q = 3 n + m``: derivatives of the Lagrangian, and of the equations
    ``d``.

    ``xi_i = h sum_j matrix_ij nu_j``. Hessians are symmetric. The slope and the defect have k columns, the first of
    them Newton's.
    """

    hessian: Float[np.ndarray, "B N s q q"]
    constraints: Float[np.ndarray, "B N s n q"]
    slope: Float[np.ndarray, "B N s q k"]
    defect: Float[np.ndarray, "B N s n k"]


@final
class Ends(NamedTuple):
    """At both ends of each step, in ``(dx, deta)``, ``eta = h sum_j b_j nu_j``: derivatives of the Lagrangian and of
    the ends. Hessians are symmetric."""

    hessian: Float[np.ndarray, "B N 2n 2n"]
    left: Float[np.ndarray, "B N n 2n"]
    right: Float[np.ndarray, "B N n 2n"]
    slope: Float[np.ndarray, "B N 2n k"]


@final
class Parts(NamedTuple):
    """Blocks of the condensed system, ``z = n + s m``, and what ``nu_0`` moves the ends before and after each step
    by."""

    hessian: Float[np.ndarray, "B N z z"]
    left: Float[np.ndarray, "B N n z"]
    right: Float[np.ndarray, "B N n z"]
    slope: Float[np.ndarray, "B N z k"]
    before: Float[np.ndarray, "B N n k"]
    after: Float[np.ndarray, "B N n k"]

    def system(self, gap: Float[np.ndarray, "B N+1 n k"], start: np.ndarray, end: np.ndarray) -> BlockSystem:
        """The condensed system, from the gaps of the nodes and the fixed coordinates of both ends, shape ``(B, n)``."""
        gap = np.array(gap, dtype=float)
        with np.errstate(invalid="ignore"):
            gap[:, :-1] += self.before
            gap[:, 1:] -= self.after
        return BlockSystem(self.hessian, self.left, self.right, self.slope, gap, start, end)


@final
class Condensed(NamedTuple):
    """What ``expand`` needs; ``kept``: factors of ``C_nu``, their swaps, and ``[N | nu_0]`` of all steps."""

    points: Points
    ends: Ends
    table: tuple[np.ndarray, np.ndarray, np.ndarray]
    kept: tuple[np.ndarray, np.ndarray, np.ndarray]


@final
class Expanded(NamedTuple):
    """The whole step of Newton's method."""

    dx: Float[np.ndarray, "B N n k"]
    dnu: Float[np.ndarray, "B N s n k"]
    du: Float[np.ndarray, "B N s m k"]
    dlambda: Float[np.ndarray, "B N s n k"]


def condense(points: Points, ends: Ends, h: Float[np.ndarray, "B N"], tableau: Tableau) -> tuple[Parts, Condensed]:
    """Eliminate ``nu`` and ``lambda`` from Newton's equations of every step.

    With ``d = T w + t``, ``T`` and ``t`` having the rows ``N`` and ``nu_0`` for ``nu``, a null-space step: the
    condensed Hessian is ``T' H T``, the slope ``T' (g + H t)``, the ends' derivatives are ``left T`` and ``right T``.
    Where the equations of a step do not determine ``nu``, its blocks are not finite.
    """
    from . import condensing_kernels

    batch, count, s, n, q = points.constraints.shape
    columns, m = points.slope.shape[4], q - 3 * n
    z, p = n + s * m, s * n
    points, ends = Points(*map(plain, points)), Ends(*map(plain, ends))
    table = plain(h).ravel(), plain(tableau.matrix), plain(tableau.weights)
    shape, width = (batch, count), whole(z + columns)
    blocks = [np.empty((*shape, *tail)) for tail in ((z, z), (n, z), (n, z), (z, columns), (n, columns), (n, columns))]
    steps = batch * count
    kept = np.empty((steps, p, p)), np.empty((steps, p), np.int64), aligned(steps, p, width)
    arrays = _steps(points), _steps(ends), table

    def run(part: range) -> None:
        work = scratch(((p, whole(p) + width), (q, width), (q, width), (p,), (z, width)))
        condensing_kernels.condense(part.start, part.stop, *arrays, tuple(work), kept, _steps(blocks))

    in_threads(run, steps, p * p * (p + z) + s * q * z * (2 * n + z))
    return Parts(*blocks), Condensed(points, ends, table, kept)


def expand(
    condensed: Condensed, steps: Float[np.ndarray, "B N z k"], multipliers: Float[np.ndarray, "B N+1 n k"]
) -> Expanded:
    """The whole step from that of the condensed system, with the steps of the multipliers of the points."""
    from . import condensing_kernels

    points, ends, table, kept = condensed
    batch, count, s, n, q = points.constraints.shape
    z, columns, total = steps.shape[2], steps.shape[3], batch * count
    out = np.empty((2, columns, total, s * n))
    both = _steps(points), _steps(ends)

    def run(part: range) -> None:
        work = np.empty(q), np.empty(s * n), np.empty(2 * n)
        for j in range(columns):
            given = steps[..., j], multipliers[:, :-1, :, j], multipliers[:, 1:, :, j]
            slopes = points.slope[..., j], ends.slope[..., j]
            solved = *_steps(map(plain, given)), z + j, *_steps(map(plain, slopes))
            condensing_kernels.expand(part.start, part.stop, *both, table, work, kept, solved, (out[0, j], out[1, j]))

    in_threads(run, total, s * n * (z + s * n + 3 * q))
    velocities, lambdas = np.moveaxis(out, 1, -1).reshape(2, batch, count, s, n, columns)
    return Expanded(steps[:, :, :n], velocities, steps[:, :, n:].reshape(batch, count, s, q - 3 * n, columns), lambdas)


def slopes(
    points: tuple[np.ndarray, np.ndarray], pull: np.ndarray, condensed: Condensed
) -> tuple[tuple[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]:
    """Slopes of the Lagrangian and of the cost alone by what is left of the unknowns of the steps, shape (B, N, z), and
    by the velocities, (B, N, s, n).

    ``points``: both by the unknowns of the points, shape (B, N, s, q); ``pull``: the first one's by those of the ends.
    """
    from . import condensing_kernels

    batch, count, s, q = points[0].shape
    n = pull.shape[2] // 2
    z, steps = n + s * (q - 3 * n), batch * count
    out, inside = np.empty((2, batch, count, z)), np.empty((2, batch, count, s, n))
    given = tuple(_steps(map(plain, points))), plain(pull).reshape(steps, -1), condensed.kept[2], condensed.table
    flat = tuple(inside.reshape(2, steps, s * n)), tuple(out.reshape(2, steps, z))
    in_threads(
        lambda part: condensing_kernels.slopes(part.start, part.stop, *given, *flat), steps, 2 * s * n * (z + s + 2)
    )
    return (out[0], out[1]), (inside[0], inside[1])


def full_slope(
    points: Points, ends: Ends, h: Float[np.ndarray, "B N"], tableau: Tableau
) -> Float[np.ndarray, "B N D k"]:
    """The derivative of the Lagrangian by all unknowns ``(x, nu, u)`` of a step, ``D = n + s n + s m``."""
    batch, count, s, q, columns = points.slope.shape
    n = ends.slope.shape[2] // 2
    x, xi, nu, u = np.split(points.slope, [n, 2 * n, 3 * n], axis=3)
    steps = h[:, :, None, None, None]
    nu = nu + steps * np.einsum("ij,bkian->bkjan", tableau.matrix, xi)
    nu = nu + steps * tableau.weights[:, None, None] * ends.slope[:, :, None, n:]
    flat = nu.reshape(batch, count, s * n, columns), u.reshape(batch, count, s * (q - 3 * n), columns)
    return np.concatenate([x.sum(axis=2) + ends.slope[:, :, :n], *flat], axis=2)


def _steps(arrays: Iterable[np.ndarray]) -> tuple[np.ndarray, ...]:
    """Arrays with one leading axis for the steps of all members."""
    return tuple(a.reshape(-1, *a.shape[2:]) for a in arrays)
