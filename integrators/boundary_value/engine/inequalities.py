"""Inequalities at the points of the steps: slacks and multipliers of an interior point method, eliminated point by
point.

Where ``g(q, u) <= 0`` a slack ``s > 0`` with ``g + s = 0`` is kept off zero by the barrier ``-mu log s``, weighted as
the running cost is, so that the multipliers ``nu`` are those of the continuous problem, per unit of time [Waechter,
Biegler 2006]. An elastic inequality is ``g + s = t`` with an excess ``t > 0`` at the price ``rho t``: from a guess that
violates it the way in is not cut short, and where there is none the excess is least [Gould, Orban, Toint 2003]. With
``zeta = rho - nu``,

    nu s = mu,   zeta t = mu,   Newton's step  dnu = D (g + mu / nu - mu / zeta + J d),   1 / D = s / nu + t / zeta,

leaves at each point the Hessian ``w J' D J`` and the slope ``w J' D (g + mu (1 / nu - 1 / zeta))``, affine in ``mu``.
"""

from typing import NamedTuple, final

import numpy as np

from ....compute.threads import in_threads
from ....manifolds.numerics.tolerances import EPS, HALF
from ..transcription.iterate import Slacks
from .arrays import plain

BOUNDARY = 0.99  # share of the way to the boundary that a step may go
LEFT = 0.01  # of a slack: one that would be less stays as its step made it
ROUNDED = EPS**HALF  # of a slack: what it misses of its inequality is rounding
KEPT = 1e10  # a multiplier stays within this factor of mu / s
# Of its value, which is rounded, an inequality or an entry of a node is measured by where it changes by less.
VALUE = 1e-2


@final
class Held(NamedTuple):
    """The inequalities at an iterate: values (B, N, r, c), derivatives in the unknowns of a point (B, N, r, c, q),
    weights (B, N, r, c), zero where an inequality is not asked for.

    The r places of a step are its s points and, of a Gauss method, its ends where there are inequalities at nodes.
    """

    values: np.ndarray
    jacobian: np.ndarray
    weights: np.ndarray

    @property
    def asked(self) -> np.ndarray:
        """Where an inequality is to hold."""
        return self.weights > 0

    def at_points(self, stages: int) -> "Held":
        """Those of the points alone."""
        return self if self.values.shape[2] == stages else Held(*(a[:, :, :stages] for a in self))


@final
class Turn(NamedTuple):
    """A step of slacks, multipliers and excesses; how much of it stays inside, and what the whole does, shape (B,)."""

    slacks: np.ndarray
    multipliers: np.ndarray
    excess: np.ndarray
    reach: np.ndarray  # of the step of the unknowns, slacks and excesses
    dual: np.ndarray  # of that of the multipliers
    ahead: np.ndarray  # the derivative of the potential along the whole step
    lacking: np.ndarray  # the sum of the steps of the multipliers on what the inequalities lack


@final
class Surveyed(NamedTuple):
    """What is largest in the inequalities and their slacks, and sums over them, shape (B,).

    ``potential``: ``sum w (rho t - mu (log s + log t))`` with s and t in units of the inequalities.
    """

    violation: np.ndarray  # the largest |g + s - t|, in units
    excess: np.ndarray
    product: np.ndarray  # the largest of nu s and zeta t
    least: np.ndarray  # the least of them
    missing: np.ndarray  # the weighted sum of |g + s - t|, in units
    potential: np.ndarray
    held: np.ndarray  # the weighted sum of nu (g + s - t)
    dear: np.ndarray  # the highest price, relative to the first one; zero where nothing is elastic
    cheap: np.ndarray  # 1 where a multiplier comes near to its price, and that may still rise
    left: np.ndarray  # the largest excess whose multiplier comes near to the highest price, in units


def central(held: Held, barrier: np.ndarray, price: np.ndarray) -> Slacks:
    """Slacks, multipliers and excesses with ``g + s = t``, ``nu s = zeta t = mu``; where the price is infinite ``s =
    -g``."""
    g, mu = held.values, barrier[:, None, None, None]
    asked, elastic = held.asked, np.isfinite(price)
    rho = np.where(elastic, price, 1.0)
    # mu / nu - mu / (rho - nu) = -g has one solution between 0 and rho.
    a, b = g, g * rho - 2 * mu
    root = np.sqrt(b * b + 4 * a * mu * rho)
    soft = np.where(b < 0, 2 * mu * rho / (root - b), (b + root) / np.where(a == 0, 1.0, 2 * a))
    nu = np.where(elastic, soft, mu / np.where(g < 0, -g, 1.0))
    nu = np.where(asked, nu, 0.0)
    slacks = np.where(asked, mu / np.where(asked, nu, 1.0), 1.0)
    excess = np.where(asked & elastic, slacks + g, 0.0)
    least = mu / rho
    excess = np.where(asked & elastic, np.maximum(excess, least), 0.0)
    return Slacks(slacks, nu, excess, np.where(asked & elastic, price, np.inf), barrier)


def raised(hessian: np.ndarray, slope: np.ndarray, held: Held, slacks: Slacks) -> np.ndarray:
    """The slope of the points (B, N, s, q) in two columns, the second times the barrier; raises their Hessians in
    place."""
    from . import inequality_kernels

    slopes, given = np.empty((*slope.shape, 2)), (_points(held), _points(slacks))
    own = hessian, plain(slope), slopes

    def run(part: range) -> None:
        inequality_kernels.raise_points(part.start, part.stop, *given, *own)

    in_threads(run, len(slope), held.jacobian[0].size * slope.shape[3])
    return slopes


def stiffness(slacks: Slacks) -> np.ndarray:
    """``D = 1 / (s / nu + t / zeta)``."""
    nu = slacks.multipliers
    return nu / (slacks.slacks + np.where(slacks.elastic, nu * slacks.excess / slacks.rest, 0.0))


def turned(held: Held, slacks: Slacks, steps: np.ndarray) -> Turn:
    """The step of slacks and multipliers that belongs to steps of the unknowns of the points, shape (B, N, s, q)."""
    from . import inequality_kernels

    moves, found = _three(held.values), np.empty((len(steps), 4))
    given = _points(held), _points(slacks), plain(steps), BOUNDARY, moves, found

    def run(part: range) -> None:
        inequality_kernels.turn(part.start, part.stop, *given)

    in_threads(run, len(steps), held.jacobian[0].size)
    return Turn(*moves, found[:, 0], found[:, 1], found[:, 2], found[:, 3])


def moved(slacks: Slacks, turn: Turn, fraction: np.ndarray) -> Slacks:
    """Slacks, excesses and multipliers after fractions of what stays inside."""
    from . import inequality_kernels

    out, moves = _three(turn.slacks), turn[:3]
    parts = plain(fraction * turn.reach), plain(turn.dual)
    given = _points(slacks), moves, parts, KEPT, out

    def run(part: range) -> None:
        inequality_kernels.move(part.start, part.stop, *given)

    in_threads(run, len(fraction), turn.slacks[0].size)
    return Slacks(*out, slacks.price, slacks.barrier)


def fitted(held: Held, slacks: Slacks) -> Slacks:
    """The slacks with ``s = t - g`` where an inequality holds, if a step misses that, as it does where ``g`` is
    curved."""
    own, made = slacks.excess - held.values, slacks.slacks
    missed = held.asked & (own >= LEFT * made) & (np.abs(own - made) > ROUNDED * made)
    return slacks._replace(slacks=np.where(missed, own, slacks.slacks)) if missed.any() else slacks


def surveyed(
    held: Held, slacks: Slacks, limits: np.ndarray, rate: np.ndarray, prices: tuple[float, float, float]
) -> np.ndarray:
    """What is largest in the inequalities and their slacks, and their sums: the fields of ``Surveyed``.

    ``limits``: units of the inequalities, shape (B, c), ``rate``: of the cost rate, (B,); ``prices``: the first one,
    the share of its price that a multiplier comes near to it with, and the highest one.
    """
    from . import inequality_kernels

    found, units = np.zeros((len(Surveyed._fields), len(limits))), (plain(limits), plain(rate))
    given = _points(held), _points(slacks)

    def run(part: range) -> None:
        room = np.empty(limits.shape[1])
        inequality_kernels.survey(part.start, part.stop, *given, (*units, room), VALUE, prices, found)

    in_threads(run, len(limits), 8 * held.values[0].size)
    return found


def _three(like: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return np.empty(like.shape), np.empty(like.shape), np.empty(like.shape)


def _points(arrays: Held | Slacks) -> tuple[np.ndarray, ...]:
    """What the kernels take."""
    return tuple(map(plain, arrays))
