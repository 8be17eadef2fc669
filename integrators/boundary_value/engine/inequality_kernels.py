"""Compiled passes over the inequalities at the points of the steps.

Slacks are ``(s, nu, t, rho, mu)``, arrays of shape ``(B, N, s, c)`` but for the barrier, shape ``(B,)``.
"""

import math

import numpy as np

from .extent_kernels import larger
from .vectors import compiled, inner

Five = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]


@inner
def _stiffness(s: float, nu: float, t: float, rho: float) -> float:
    """``D = 1 / (s / nu + t / zeta)``."""
    return nu / (s + (nu * t / (rho - nu) if rho < math.inf else 0.0))


@inner
def _aside(nu: float, rho: float) -> float:
    """``1 / nu - 1 / zeta``."""
    return 1 / nu - 1 / (rho - nu) if nu > 0 else 0.0


@inner
def _dearest(price: float, nu: float, excess: float, unit: float, prices: tuple, out: np.ndarray, m: int) -> None:
    """What the price of an elastic inequality says, ``unit``: that of the price times its own; see ``survey``."""
    first, near, most = prices
    out[7, m] = larger(out[7, m], price / (first * unit))
    if nu > near * price:
        if price < most * unit:
            out[8, m] = 1.0
        else:
            out[9, m] = larger(out[9, m], excess)


@compiled
def survey(
    first: int, last: int, held: tuple, slacks: Five, units: tuple, share: float, prices: tuple, out: np.ndarray
) -> None:
    """Survey the members ``first`` to ``last``.

    ``units``: of the inequalities and of the cost rate, and room for what inequalities are measured by; ``share``: of
    the largest value, which measures them where it is more; ``prices``: the first one, what share of its price a
    multiplier comes near to it with, and the highest one, both relative to their units. ``out``, shape ``(10, B)``,
    comes as zeros: the largest violation and excess; the largest of ``nu s`` and ``zeta t``, and the least; ``sum w
    |g + s - t|``, in units; ``sum w (rho t - mu (log s + log t))``; ``sum w nu (g + s - t)``; the highest price,
    relative to the first one; 1 where a multiplier comes near to a price below the highest; the largest excess
    whose multiplier comes near to the highest price.
    """
    (values, _, weights), (s, nu, t, rho, mu), (limits, rate, room) = held, slacks, units
    _, steps, stages, size = values.shape
    for m in range(first, last):
        for i in range(size):
            room[i] = limits[m, i]
            for n in range(steps):
                for j in range(stages):
                    if weights[m, n, j, i] > 0:
                        room[i] = larger(room[i], share * abs(values[m, n, j, i]))
        least = math.inf
        for n in range(steps):
            for j in range(stages):
                for i in range(size):
                    w, soft = weights[m, n, j, i], rho[m, n, j, i] < math.inf
                    if not w > 0:
                        continue
                    missing = values[m, n, j, i] + s[m, n, j, i] - t[m, n, j, i]
                    out[0, m] = larger(out[0, m], abs(missing) / room[i])
                    out[1, m] = larger(out[1, m], t[m, n, j, i] / room[i])
                    product, cost = s[m, n, j, i] * nu[m, n, j, i], -mu[m] * math.log(s[m, n, j, i] / limits[m, i])
                    out[2, m], least = larger(out[2, m], product), -larger(-least, -product)
                    if soft:
                        product = t[m, n, j, i] * (rho[m, n, j, i] - nu[m, n, j, i])
                        out[2, m], least = larger(out[2, m], product), -larger(-least, -product)
                        cost += rho[m, n, j, i] * t[m, n, j, i] - mu[m] * math.log(t[m, n, j, i] / limits[m, i])
                        excess, unit = t[m, n, j, i] / limits[m, i], rate[m] / limits[m, i]
                        _dearest(rho[m, n, j, i], nu[m, n, j, i], excess, unit, prices, out, m)
                    out[4, m] += w * abs(missing) / limits[m, i]
                    out[5, m] += w * cost
                    out[6, m] += w * nu[m, n, j, i] * missing
        out[3, m] = least


@compiled
def raise_points(
    first: int, last: int, held: tuple, slacks: Five, hessian: np.ndarray, slope: np.ndarray, slopes: np.ndarray
) -> None:
    """Add ``w J' D J`` to the Hessians of points; their slopes in two columns, the second times the barrier."""
    (values, jacobian, weights), (s, nu, t, rho, _), (_, steps, stages, size) = held, slacks, held[0].shape
    z = slope.shape[3]
    for m in range(first, last):
        for n in range(steps):
            for j in range(stages):
                for a in range(z):
                    slopes[m, n, j, a, 0], slopes[m, n, j, a, 1] = slope[m, n, j, a], 0.0
                for i in range(size):
                    w = weights[m, n, j, i]
                    if w == 0:
                        continue
                    stiff = w * _stiffness(s[m, n, j, i], nu[m, n, j, i], t[m, n, j, i], rho[m, n, j, i])
                    own, aside = stiff * values[m, n, j, i], stiff * _aside(nu[m, n, j, i], rho[m, n, j, i])
                    for a in range(z):
                        g = jacobian[m, n, j, i, a]
                        if g == 0:
                            continue
                        slopes[m, n, j, a, 0] += g * own
                        slopes[m, n, j, a, 1] += g * aside
                        for b in range(z):
                            hessian[m, n, j, a, b] += g * stiff * jacobian[m, n, j, i, b]


@inner
def lowered(
    barrier: float, rate: float, last: float, found: tuple, error: float, tolerance: float, rules: tuple
) -> tuple[float, bool]:
    """The barrier, lower while its problem is solved, and whether excesses are too cheap to lower it.

    ``rate``: its unit; ``last``: the last one, relative; ``found``: the largest product of a slack and a multiplier,
    the least, and 1 where a multiplier comes near to its price; ``rules``: those of ``barrier``.
    """
    (most, least, cheap), (few, less, faster, reached, tells) = found, rules
    while True:
        off = larger(larger(most - barrier, barrier - least), 0.0)
        if not (error <= max(few * barrier / rate, tolerance) and off <= few * barrier):
            return barrier, False
        own = barrier / rate
        told = cheap > 0 and own <= tells
        # The last barrier times the rate and back is rounded, to more than it was for some rates.
        if told or not own > (1 + reached) * last:
            return barrier, told
        # Newton's steps leave the square of a barrier: where they are that good, the last one is within reach.
        near = own * own <= last and few * error <= own
        barrier = (last if near else max(last, min(less * own, own**faster))) * rate


@compiled
def lower(
    barrier: np.ndarray,
    rate: np.ndarray,
    last: np.ndarray,
    found: tuple,
    error: np.ndarray,
    tolerance: float,
    rules: tuple,
    out: tuple,
) -> None:
    """Of each member what ``lowered`` finds."""
    for m in range(barrier.size):
        own = found[0][m], found[1][m], found[2][m]
        out[0][m], out[1][m] = lowered(barrier[m], rate[m], last[m], own, error[m], tolerance, rules)


@inner
def _shorter(reach: float, value: float, step: float, central: float, share: float) -> float:
    """The fraction of a step that leaves a share of a value, or of the central one if that is less, if it is the
    smallest so far."""
    return min(reach, (share * min(value, central) - value) / step) if step < 0 else reach


@compiled
def turn(
    first: int, last: int, held: tuple, slacks: Five, ways: np.ndarray, share: float, moves: tuple, out: np.ndarray
) -> None:
    """Steps of slacks, multipliers and excesses from those of the unknowns of the points.

    ``out``, shape ``(B, 4)``: how much of those of the slacks and of the multipliers stays inside; the derivative of
    the barrier and of what excesses cost along the whole; ``sum w dnu (g + s - t)``.
    """
    (values, jacobian, weights), (s, nu, t, rho, mu), (_, steps, stages, size) = held, slacks, held[0].shape
    for m in range(first, last):
        out[m, 0], out[m, 1], out[m, 2], out[m, 3] = 1.0, 1.0, 0.0, 0.0
        for n in range(steps):
            for j in range(stages):
                for i in range(size):
                    w, g, soft = weights[m, n, j, i], values[m, n, j, i], rho[m, n, j, i] < math.inf
                    ds, dnu, dt = 0.0, 0.0, 0.0
                    if w > 0:
                        ahead, rest = g, rho[m, n, j, i] - nu[m, n, j, i]
                        for a in range(ways.shape[3]):
                            ahead += jacobian[m, n, j, i, a] * ways[m, n, j, a]
                        dnu = _stiffness(s[m, n, j, i], nu[m, n, j, i], t[m, n, j, i], rho[m, n, j, i])
                        dnu *= ahead + mu[m] * _aside(nu[m, n, j, i], rho[m, n, j, i])
                        ds = (mu[m] - s[m, n, j, i] * dnu) / nu[m, n, j, i] - s[m, n, j, i]
                        paid = -mu[m] * ds / s[m, n, j, i]
                        if soft:
                            dt = (mu[m] + t[m, n, j, i] * dnu) / rest - t[m, n, j, i]
                            paid += (rho[m, n, j, i] - mu[m] / t[m, n, j, i]) * dt
                            out[m, 0] = _shorter(out[m, 0], t[m, n, j, i], dt, mu[m] / rest, share)
                            out[m, 1] = _shorter(out[m, 1], rest, -dnu, mu[m] / t[m, n, j, i], share)
                        out[m, 0] = _shorter(out[m, 0], s[m, n, j, i], ds, mu[m] / nu[m, n, j, i], share)
                        out[m, 1] = _shorter(out[m, 1], nu[m, n, j, i], dnu, mu[m] / s[m, n, j, i], share)
                        out[m, 2] += w * paid
                        out[m, 3] += w * dnu * (g + s[m, n, j, i] - t[m, n, j, i])
                    moves[0][m, n, j, i], moves[1][m, n, j, i], moves[2][m, n, j, i] = ds, dnu, dt


@compiled
def move(first: int, last: int, slacks: Five, moves: tuple, parts: tuple, kept: float, out: tuple) -> None:
    """Slacks, multipliers and excesses after parts of their steps, primal and dual; multipliers stay near ``mu / s``.

    ``kept``: by what factor these may be apart where an inequality is not elastic.
    """
    (s, nu, t, rho, mu), (primal, dual), (_, steps, stages, size) = slacks, parts, slacks[0].shape
    for m in range(first, last):
        for n in range(steps):
            for j in range(stages):
                for i in range(size):
                    out[0][m, n, j, i] = s[m, n, j, i] + primal[m] * moves[0][m, n, j, i]
                    out[2][m, n, j, i] = t[m, n, j, i] + primal[m] * moves[2][m, n, j, i]
                    found = nu[m, n, j, i] + dual[m] * moves[1][m, n, j, i]
                    if not rho[m, n, j, i] < math.inf:
                        centre = mu[m] / out[0][m, n, j, i]
                        found = min(max(found, centre / kept), kept * centre) if found > 0 else 0.0
                    out[1][m, n, j, i] = found
