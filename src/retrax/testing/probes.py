"""Searches for what a manifold leaves out: a normal direction that its equations miss, a tangent one that its points
miss."""

from collections.abc import Callable

import numpy as np

from .draws import Sampler
from .precision import precision

LENGTH_RATIO = 2.0**7  # the longer of two displacements over the shorter: curvature is small beside the longer one
NEIGHBOURHOODS = 8  # points of a cloud whose neighbourhoods are examined


def least_visible_normal(
    violation: Callable[[np.ndarray], np.ndarray], x: np.ndarray, basis: np.ndarray
) -> tuple[float, np.ndarray]:
    """How much the equations see of the normal displacement that they see least of, and the unit normal vector along
    it.

    About 1 where the violations grow in proportion to the displacement, about ``1 / LENGTH_RATIO`` where they grow as
    its square. The violations are to first order a convex, homogeneous function of the displacement. It is 0 along one
    that all its slopes found so far are normal to, or its slope there is a new one: as many slopes as there are normals
    are enough.
    """
    if not np.all(np.isfinite(basis)):
        return np.nan, basis[0]
    normals = np.linalg.svd(basis, full_matrices=True)[2][basis.shape[0] :]
    count, size = len(normals), 1 + np.max(np.abs(x))
    # A direction is turned by this to see the slope of the violations, and rates are compared with this fraction of the
    # largest: where nothing grows at all there is rounding alone.
    short, bend = precision().displacement, precision().quarter
    long = LENGTH_RATIO * short
    bends = np.concatenate([np.zeros((1, count)), np.eye(count)])
    slopes, rates, tried = np.zeros((0, count)), [], []
    n = np.ones(count) / np.sqrt(count)
    for _ in range(count + 1):
        moved = np.concatenate([short * (n + bend * bends), long * n[None], -short * n[None], -long * n[None]])
        found = np.stack([violation(y) for y in x + size * moved @ normals])
        seen, far = found[[0, -2]] / (short * size), found[[-3, -1]] / (long * size)
        rates.append(np.stack([seen, far]))
        tried.append(n)
        slope = (found[1 : 1 + count] - found[0]) / (short * bend * size)
        slopes = np.concatenate([slopes, np.nan_to_num(slope)[None]])
        n = np.linalg.svd(slopes, full_matrices=True)[2][-1]
    near, far = np.swapaxes(np.stack(rates), 0, 1)
    ratios = np.min(near / np.maximum(far, bend * max(np.max(far), 1e-300)), axis=1)
    worst = int(np.argmin(np.nan_to_num(ratios, nan=-1.0)))
    return float(ratios[worst]), tried[worst] @ normals


def least_spread(sampler: Sampler, dimension: int) -> float:
    """Mean square of the rarest tangent direction from a random point to its neighbours, times the dimension.

    The median over some points; about 1 where points are spread evenly, 0 where they lie on a smaller manifold, as
    large as its curvature makes it over their distances. Lengths are measured in units of the points' own spread.
    """
    cloud = np.stack([sampler.random(seed) for seed in range(1000, 1000 + 40 * (dimension + 2))])
    _, s, axes = np.linalg.svd(cloud - cloud.mean(axis=0), full_matrices=False)
    kept = s > precision().half * max(s[0], 1e-300)
    if kept.sum() < dimension:
        return 0.0
    scaled = axes[kept] / s[kept, None]
    found = []
    for seed, x in zip(range(1000, 1000 + NEIGHBOURHOODS), cloud, strict=False):
        steps = (cloud - x) @ scaled.T
        distances = np.linalg.norm(steps, axis=1)
        near = np.argsort(distances)[1 : 3 + 2 * dimension]
        _, sizes, tangent = np.linalg.svd(np.nan_to_num(sampler.at(x, seed)[1] @ scaled.T), full_matrices=False)
        along = steps[near] @ tangent.T
        along = along / np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-300)
        # Else no point lies off the plane that a tangent vector leads out of.
        reached = sizes[-1] > precision().half * sizes[0]
        found.append(reached * dimension * np.linalg.eigvalsh(along.T @ along / len(along))[0])
    return float(np.median(found))
