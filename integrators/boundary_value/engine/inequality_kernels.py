"""Compiled passes over the inequalities at the points of the steps.

Slacks are ``(s, nu, t, rho, mu)``, arrays of shape ``(B, P, c)`` but for the barrier, shape ``(B,)``.
"""

import math

import numpy as np

from .extent_kernels import larger
from .factors import compiled, inner

Five = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]


@inner
def _stiffness(s: float, nu: float, t: float, rho: float) -> float:
    """``D = 1 / (s / nu + t / zeta)``."""
    return nu / (s + (nu * t / (rho - nu) if rho < math.inf else 0.0))


@inner
def _aside(nu: float, rho: float) -> float:
    """``1 / nu - 1 / zeta``."""
    return 1 / nu - 1 / (rho - nu) if nu > 0 else 0.0


@compiled
def survey(
    first: int, last: int, values: np.ndarray, weights: np.ndarray, slacks: Five, units: tuple, share: float, out: np.ndarray
) -> None:
    """Survey the members ``first`` to ``last``.

    ``units``: of the inequalities, and room for what they are measured by; ``share``: of the largest value, which measures them
    where it is more. ``out``, shape ``(B, 7)``, comes as zeros: the largest violation and excess; the largest of ``nu s`` and
    ``zeta t``, and their largest difference from the barrier; ``sum w |g + s - t|``, in units;
    ``sum w (rho t - mu (log s + log t))``; ``sum w nu (g + s - t)``.
    """
    (s, nu, t, rho, mu), (limits, room), (_, count, size) = slacks, units, values.shape
    for m in range(first, last):
        for i in range(size):
            room[i] = limits[m, i]
            for k in range(count):
                if weights[m, k, i] > 0:
                    room[i] = larger(room[i], share * abs(values[m, k, i]))
        for k in range(count):
            for i in range(size):
                w, soft = weights[m, k, i], rho[m, k, i] < math.inf
                if not w > 0:
                    continue
                missing = values[m, k, i] + s[m, k, i] - t[m, k, i]
                out[m, 0] = larger(out[m, 0], abs(missing) / room[i])
                out[m, 1] = larger(out[m, 1], t[m, k, i] / room[i])
                product, cost = s[m, k, i] * nu[m, k, i], -mu[m] * math.log(s[m, k, i] / limits[m, i])
                out[m, 2], out[m, 3] = larger(out[m, 2], product), larger(out[m, 3], abs(product - mu[m]))
                if soft:
                    product = t[m, k, i] * (rho[m, k, i] - nu[m, k, i])
                    out[m, 2], out[m, 3] = larger(out[m, 2], product), larger(out[m, 3], abs(product - mu[m]))
                    cost += rho[m, k, i] * t[m, k, i] - mu[m] * math.log(t[m, k, i] / limits[m, i])
                out[m, 4] += w * abs(missing) / limits[m, i]
                out[m, 5] += w * cost
                out[m, 6] += w * nu[m, k, i] * missing


@compiled
def raise_points(
    first: int, last: int, held: tuple, slacks: Five, hessian: np.ndarray, slope: np.ndarray, slopes: np.ndarray
) -> None:
    """Add ``w J' D J`` to the Hessians of points; their slopes in two columns, the second times the barrier."""
    (values, jacobian, weights), (s, nu, t, rho, _), (_, count, size) = held, slacks, held[0].shape
    z = slope.shape[2]
    for m in range(first, last):
        for k in range(count):
            for a in range(z):
                slopes[m, k, a, 0], slopes[m, k, a, 1] = slope[m, k, a], 0.0
            for i in range(size):
                w = weights[m, k, i]
                if w == 0:
                    continue
                stiff = w * _stiffness(s[m, k, i], nu[m, k, i], t[m, k, i], rho[m, k, i])
                own, aside = stiff * values[m, k, i], stiff * _aside(nu[m, k, i], rho[m, k, i])
                for a in range(z):
                    g = jacobian[m, k, i, a]
                    if g == 0:
                        continue
                    slopes[m, k, a, 0] += g * own
                    slopes[m, k, a, 1] += g * aside
                    for b in range(z):
                        hessian[m, k, a, b] += g * stiff * jacobian[m, k, i, b]


@inner
def _shorter(reach: float, value: float, step: float, share: float) -> float:
    """The fraction of a step that leaves its share of a value, if that is the smallest so far."""
    return min(reach, -share * value / step) if step < 0 else reach


@compiled
def turn(
    first: int, last: int, held: tuple, slacks: Five, steps: np.ndarray, share: float, moves: tuple, out: np.ndarray
) -> None:
    """Steps of slacks, multipliers and excesses from those of the unknowns of the points.

    ``out``, shape ``(B, 4)``: how much of those of the slacks and of the multipliers stays inside; the derivative of the
    barrier and of what excesses cost along the whole; ``sum w dnu (g + s - t)``.
    """
    (values, jacobian, weights), (s, nu, t, rho, mu), (_, count, size) = held, slacks, held[0].shape
    for m in range(first, last):
        out[m, 0], out[m, 1], out[m, 2], out[m, 3] = 1.0, 1.0, 0.0, 0.0
        for k in range(count):
            for i in range(size):
                w, g, soft = weights[m, k, i], values[m, k, i], rho[m, k, i] < math.inf
                ds, dnu, dt = 0.0, 0.0, 0.0
                if w > 0:
                    ahead, rest = g, rho[m, k, i] - nu[m, k, i]
                    for a in range(steps.shape[2]):
                        ahead += jacobian[m, k, i, a] * steps[m, k, a]
                    dnu = _stiffness(s[m, k, i], nu[m, k, i], t[m, k, i], rho[m, k, i])
                    dnu *= ahead + mu[m] * _aside(nu[m, k, i], rho[m, k, i])
                    ds = (mu[m] - s[m, k, i] * dnu) / nu[m, k, i] - s[m, k, i]
                    paid = -mu[m] * ds / s[m, k, i]
                    if soft:
                        dt = (mu[m] + t[m, k, i] * dnu) / rest - t[m, k, i]
                        paid += (rho[m, k, i] - mu[m] / t[m, k, i]) * dt
                        out[m, 0] = _shorter(out[m, 0], t[m, k, i], dt, share)
                        out[m, 1] = _shorter(out[m, 1], rest, -dnu, share)
                    out[m, 0] = _shorter(out[m, 0], s[m, k, i], ds, share)
                    out[m, 1] = _shorter(out[m, 1], nu[m, k, i], dnu, share)
                    out[m, 2] += w * paid
                    out[m, 3] += w * dnu * (g + s[m, k, i] - t[m, k, i])
                moves[0][m, k, i], moves[1][m, k, i], moves[2][m, k, i] = ds, dnu, dt


@compiled
def move(first: int, last: int, slacks: Five, moves: tuple, parts: tuple, kept: float, out: tuple) -> None:
    """Slacks, multipliers and excesses after parts of their steps, primal and dual; multipliers stay near ``mu / s``.

    ``kept``: by what factor these may be apart where an inequality is not elastic.
    """
    (s, nu, t, rho, mu), (primal, dual), (_, count, size) = slacks, parts, slacks[0].shape
    for m in range(first, last):
        for k in range(count):
            for i in range(size):
                out[0][m, k, i] = s[m, k, i] + primal[m] * moves[0][m, k, i]
                out[2][m, k, i] = t[m, k, i] + primal[m] * moves[2][m, k, i]
                found = nu[m, k, i] + dual[m] * moves[1][m, k, i]
                if not rho[m, k, i] < math.inf:
                    centre = mu[m] / out[0][m, k, i]
                    found = min(max(found, centre / kept), kept * centre) if found > 0 else 0.0
                out[1][m, k, i] = found
