"""Compiled pass over a trajectory and its KKT system that finds what is largest in them."""

from .factors import compiled, inner


@inner
def larger(a: float, b: float) -> float:
    """The larger of both; what is not a number stays."""
    return b if b > a or b != b else a


@compiled
def survey(first: int, last: int, trajectory: tuple, blocks: tuple, out: tuple) -> None:
    """Survey the members ``first`` to ``last``.

    ``trajectory``: nodes, frames, coordinates of the multipliers, gaps; ``blocks``: Hessian, left, right, slope,
    gradient of the cost; ``out``: the fields of the extent, which come as the least that they can be, and room for two
    sums.
    """
    (nodes, frames, coordinates, gap), (hessian, left, right, slope, gradient) = trajectory, blocks
    highest, lowest, support, missing, lacking, held, parts, slopes, curvature, sums = out
    (_, count, n, size), z = frames.shape, slope.shape[2]
    for m in range(first, last):
        for k in range(count):
            for e in range(size):
                highest[m, e], lowest[m, e] = (
                    larger(highest[m, e], nodes[m, k, e]),
                    larger(lowest[m, e], -nodes[m, k, e]),
                )
            for a in range(n):
                missing[m, a] += abs(gap[m, k, a])
                held[m] += coordinates[m, k, a] * gap[m, k, a]
                lacking[m, a] = larger(lacking[m, a], abs(gap[m, k, a]))
                for e in range(size):
                    support[m, a, e] = larger(support[m, a, e], abs(frames[m, k, a, e]))
        for k in range(count - 1):
            for i in range(z):
                sums[0, i], sums[1, i] = 0.0, 0.0
            for a in range(n):
                for i in range(z):
                    sums[0, i] += left[m, k, a, i] * coordinates[m, k, a]
                    sums[1, i] += right[m, k, a, i] * coordinates[m, k + 1, a]
            for i in range(z):
                parts[m, i] = larger(parts[m, i], abs(gradient[m, k, i]) + abs(sums[0, i]) + abs(sums[1, i]))
                slopes[m, i] = larger(slopes[m, i], abs(slope[m, k, i]))
                curvature[m, i] = larger(curvature[m, i], abs(hessian[m, k, i, i]))
