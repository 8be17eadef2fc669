"""Inequalities at the points of the steps: slacks and multipliers of an interior point method, eliminated point by point.

Where ``g(q, u) <= 0`` a slack ``s > 0`` with ``g + s = 0`` is kept off zero by the barrier ``-mu log s``, weighted as the
running cost is, so that the multipliers ``nu`` are those of the continuous problem, per unit of time [Waechter, Biegler 2006].
An elastic inequality is ``g + s = t`` with an excess ``t > 0`` at the price ``rho t``: from a guess that violates it the way in
is not cut short, and where there is none the excess is least [Gould, Orban, Toint 2003]. With ``zeta = rho - nu``,

    nu s = mu,   zeta t = mu,   Newton's step  dnu = D (g + mu / nu - mu / zeta + J d),   1 / D = s / nu + t / zeta,

leaves at each point the Hessian ``w J' D J`` and the slope ``w J' D (g + mu (1 / nu - 1 / zeta))``, affine in ``mu``.
"""

from typing import NamedTuple, final

import numpy as np

BOUNDARY = 0.99  # share of the way to the boundary that a step may go
KEPT = 1e10  # a multiplier stays within this factor of mu / s


@final
class Slacks(NamedTuple):
    """Slacks, multipliers, excesses and their prices, shape (B, N, s, c), and the barrier of each member, shape (B,).

    The price is infinite, and the excess zero, where an inequality is not elastic.
    """

    slacks: np.ndarray
    multipliers: np.ndarray
    excess: np.ndarray
    price: np.ndarray
    barrier: np.ndarray

    @property
    def rest(self) -> np.ndarray:
        """``zeta = rho - nu``."""
        return self.price - self.multipliers

    @classmethod
    def none(cls, shape: tuple[int, ...]) -> "Slacks":
        """Those of inequalities that do not pull."""
        zero = np.zeros(shape)
        return cls(np.ones(shape), zero, zero, np.full(shape, np.inf), np.zeros(shape[0]))

    def scaled(self, factor: np.ndarray) -> "Slacks":
        """All multipliers, prices and barriers times factors, shape (B,)."""
        times = factor[:, None, None, None]
        return Slacks(self.slacks, times * self.multipliers, self.excess, times * self.price, factor * self.barrier)

    @property
    def mu(self) -> np.ndarray:
        """The barrier, with the axes of the points."""
        return self.barrier[:, None, None, None]

    @property
    def elastic(self) -> np.ndarray:
        """Where there is an excess."""
        return np.isfinite(self.price)


@final
class Held(NamedTuple):
    """The inequalities at an iterate: values (B, N, s, c), derivatives in the unknowns of a point (B, N, s, c, q), weights
    (B, N, s, c), zero where an inequality is not asked for."""

    values: np.ndarray
    jacobian: np.ndarray
    weights: np.ndarray

    @property
    def asked(self) -> np.ndarray:
        """Where an inequality is to hold."""
        return self.weights > 0

    def missing(self, slacks: Slacks) -> np.ndarray:
        """``g + s - t`` where it is asked for, shape (B, N, s, c)."""
        return np.where(self.asked, self.values + slacks.slacks - slacks.excess, 0.0)


@final
class Turn(NamedTuple):
    """A step of slacks, multipliers and excesses, and how much of it stays inside, shape (B,)."""

    slacks: np.ndarray
    multipliers: np.ndarray
    excess: np.ndarray
    reach: np.ndarray  # of the step of the unknowns, slacks and excesses
    dual: np.ndarray  # of that of the multipliers


def central(held: Held, barrier: np.ndarray, price: np.ndarray) -> Slacks:
    """Slacks, multipliers and excesses with ``g + s = t``, ``nu s = zeta t = mu``; where the price is infinite ``s = -g``."""
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


def raised(hessian: np.ndarray, slope: np.ndarray, held: Held, slacks: Slacks) -> tuple[np.ndarray, np.ndarray]:
    """The Hessian (B, N, s, q, q) of the points and their slope in two columns, the second times the barrier."""
    stiff = held.weights * stiffness(slacks)
    hessian = hessian + held.jacobian.mT @ (stiff[..., None] * held.jacobian)
    columns = np.stack([stiff * np.where(held.asked, held.values, 0.0), stiff * _aside(slacks)], axis=-1)
    slopes = held.jacobian.mT @ columns
    slopes[..., 0] += slope
    return hessian, slopes


def stiffness(slacks: Slacks) -> np.ndarray:
    """``D = 1 / (s / nu + t / zeta)``."""
    nu = slacks.multipliers
    return nu / (slacks.slacks + np.where(slacks.elastic, nu * slacks.excess / slacks.rest, 0.0))


def _aside(slacks: Slacks) -> np.ndarray:
    """``1 / nu - 1 / zeta``."""
    nu = slacks.multipliers
    return np.where(nu > 0, 1 / np.where(nu > 0, nu, 1.0) - 1 / slacks.rest, 0.0)


def turned(held: Held, slacks: Slacks, steps: np.ndarray) -> Turn:
    """The step of slacks and multipliers that belongs to steps of the unknowns of the points, shape (B, N, s, q)."""
    asked, elastic, mu, nu = held.asked, slacks.elastic, slacks.mu, slacks.multipliers
    ahead = held.values + np.einsum("bkicq,bkiq->bkic", held.jacobian, steps)
    turn = np.where(asked, stiffness(slacks) * (ahead + mu * _aside(slacks)), 0.0)
    s = np.where(asked, (mu - slacks.slacks * turn) / np.where(asked, nu, 1.0) - slacks.slacks, 0.0)
    t = np.where(asked & elastic, (mu + slacks.excess * turn) / slacks.rest - slacks.excess, 0.0)
    reach = np.minimum(_reach(slacks.slacks, s), _reach(slacks.excess, t))
    rest = np.where(elastic, slacks.rest, 1.0)
    dual = np.minimum(_reach(nu, turn), _reach(rest, np.where(elastic, -turn, 0.0)))
    return Turn(s, turn, t, reach, dual)


def _reach(value: np.ndarray, step: np.ndarray) -> np.ndarray:
    """The largest fraction of a step, up to 1, that leaves ``1 - BOUNDARY`` of every value."""
    with np.errstate(all="ignore"):
        share = np.where(step < 0, -BOUNDARY * value / step, 1.0)
    return np.minimum(share.min(axis=(1, 2, 3), initial=1.0), 1.0)


def moved(slacks: Slacks, turn: Turn, fraction: np.ndarray) -> Slacks:
    """Slacks, excesses and multipliers after fractions of what stays inside."""
    primal, dual = ((f)[:, None, None, None] for f in (fraction * turn.reach, turn.dual))
    s, t = slacks.slacks + primal * turn.slacks, slacks.excess + primal * turn.excess
    nu = slacks.multipliers + dual * turn.multipliers
    hard = np.where(nu > 0, np.clip(nu, slacks.mu / (KEPT * s), KEPT * slacks.mu / s), 0.0)
    return slacks._replace(slacks=s, excess=t, multipliers=np.where(slacks.elastic, nu, hard))


def products(slacks: Slacks, asked: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The largest of ``nu s`` and ``zeta t``, and their largest difference from the barrier, shape (B,)."""
    both = slacks.slacks * slacks.multipliers, slacks.excess * np.where(slacks.elastic, slacks.rest, 0.0)
    places = asked, asked & slacks.elastic
    largest = [np.where(a, p, 0.0).max(axis=(1, 2, 3), initial=0.0) for a, p in zip(places, both, strict=True)]
    apart = (np.where(a, np.abs(p - slacks.mu), 0.0) for a, p in zip(places, both, strict=True))
    off = [a.max(axis=(1, 2, 3), initial=0.0) for a in apart]
    return np.maximum(*largest), np.maximum(*off)


def potential(slacks: Slacks, weights: np.ndarray, limits: np.ndarray) -> np.ndarray:
    """``sum w (rho t - mu (log s + log t))``, shape (B,); s and t in units of the inequalities."""
    elastic = slacks.elastic & (weights > 0)
    t = np.where(elastic, slacks.excess, 1.0)
    logs = np.log(slacks.slacks / limits) + np.where(elastic, np.log(t / limits), 0.0)
    paid = np.where(elastic, np.where(elastic, slacks.price, 0.0) * t, 0.0)
    return (weights * (paid - slacks.mu * logs)).sum(axis=(1, 2, 3))


def potential_slope(slacks: Slacks, turn: Turn, weights: np.ndarray) -> np.ndarray:
    """The derivative of the potential along a step, shape (B,)."""
    elastic = slacks.elastic & (weights > 0)
    t = np.where(elastic, slacks.excess, 1.0)
    paid = np.where(elastic, (np.where(elastic, slacks.price, 0.0) - slacks.mu / t) * turn.excess, 0.0)
    return (weights * (paid - slacks.mu * turn.slacks / slacks.slacks)).sum(axis=(1, 2, 3))
