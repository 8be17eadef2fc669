"""Whether a space of another library is a manifold in its ambient space, told at random points before it is wrapped."""

import numpy as np

from ...manifolds import InvalidInputError
from ...manifolds.numerics.rank import numerical_rank
from .differences import slopes
from .manifold import HostSpace, WrappedManifold, WrappedRetraction, moved_points, projectors_of

_POINTS = 2  # random points at which a wrapped manifold is checked
# Distances from the manifold that are rounding, and singular values of projected vectors that are zero.
_ROUNDING, _TOLERANCE = 1e-9, 1e-6


def wrap(host: HostSpace, name: str) -> tuple[WrappedManifold, WrappedRetraction]:
    """A space as a manifold with a retraction. Raises ``InvalidInputError``, with the reason, if it is not one."""
    for seed in range(_POINTS):
        try:
            wrong = _describe_point(host, seed) or _describe_geometry(host, seed)
        except Exception as reason:
            raise InvalidInputError(
                f"{name} cannot be used: its own functions fail at its random points: {reason}; try the same space by "
                "matrices"
            ) from reason
        if wrong:
            raise InvalidInputError(f"{name} cannot be used: {wrong}")
    manifold = WrappedManifold(host)
    return manifold, WrappedRetraction(manifold)


def _describe_point(host: HostSpace, seed: int) -> str:
    """Words on what is wrong with a random point and its tangent space; empty if nothing is."""
    x = np.asarray(host.random_point(seed))
    if np.iscomplexobj(x):
        return (
            "its points are complex; this door takes real arrays (map them to real ones, or use U(n), SU(n), "
            "ComplexStiefel(n, p))"
        )
    if x.shape != host.shape:
        return f"its points have shape {x.shape} where it says {host.shape}"
    units = np.eye(x.size).reshape(-1, *x.shape)
    images = host.project(np.broadcast_to(x, units.shape), units).reshape(-1, x.size)
    rank = numerical_rank(images, unit=1.0, limit=_TOLERANCE).rank
    if rank != host.dimension:
        return (
            f"its tangent vectors at a point span {rank} dimensions where it says {host.dimension}: its arrays are not "
            "those of an embedded manifold"
        )
    distance = float(np.max(np.abs(host.restore(x[None]) - x)))
    if not distance <= _ROUNDING:
        return f"its own projection moves a random point of it by {distance:.1g}, expected 0"
    return "" if np.all(host.contains(x[None])) else "it takes a random point of its own for none"


def _describe_geometry(host: HostSpace, seed: int) -> str:
    """Words on which axiom fails at a random point; empty if none does."""
    start, slope, twist = _defects(host, np.asarray(host.random_point(seed), float).reshape(1, -1))
    if not start <= _ROUNDING:
        return f"R(x, 0) misses x by {start:.1g}; it is not a retraction"
    if not np.isfinite(slope + twist):
        return "R(x, v) or the tangent projection has no derivatives at a random point: values on short curves jump"
    if not slope <= _TOLERANCE:
        return f"the derivative of R(x, v) at v = 0 is not the identity, by {slope:.1g}; it is not a retraction"
    if not twist <= _TOLERANCE:
        return (
            "its tangent spaces are not those of a surface (their second fundamental form is not symmetric, by "
            f"{twist:.1g}): its points stand for classes of arrays. Use a description of the quotient by matrices, "
            "such as projectors"
        )
    return ""


def _defects(host: HostSpace, x: np.ndarray) -> tuple[float, float, float]:
    """``|R(x, 0) - x|``, ``|D_v R(x, 0) - P_x|`` and the skew part of the normal part of ``D_u P w``."""
    projectors, moved = projectors_of(host), moved_points(host)
    (p,), point = projectors(x), x.reshape(1, *host.shape)
    start = host.retract(point, np.zeros_like(point)) - point
    (slope,) = slopes(lambda z: z, moved, (len(p),))(x) - p
    (change,) = slopes(projectors, moved, p.shape)(x)
    normal = np.einsum("nm,mjk,ja,kb->nab", np.eye(len(p)) - p, change, p, p)
    twist = normal - np.swapaxes(normal, 1, 2)
    return float(np.max(np.abs(start))), float(np.max(np.abs(slope))), float(np.max(np.abs(twist)))
