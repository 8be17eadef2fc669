"""Measured facts of a retraction, from samples of tangent vectors and from its inverse."""

from collections.abc import Iterable
from typing import cast

import jax
import jax.numpy as jnp
import numpy as np

from ...manifolds import EmbeddedMetric, InvalidInputError, Metric
from ...manifolds.numerics.ambient import Ambient
from ...retractions import MidpointRetraction, Retraction
from ..draws import DomainEdge, direction
from ..numerics import CENTRAL_NODES, Vector, compiled, differences, flat, unflat
from ..precision import precision
from ..properties import SAMPLE_SEEDS, Facts, Sample
from ..report import Batch
from ..sites import Site

# Longest tangent vector of a sample where the domain has no edge, and of those at which derivatives are measured.
LONGEST_SAMPLE, MODERATE = 10.0, 1.0
SAMPLE_REACH = 0.1  # length of the tangent vectors of a sample, by default
NEAR_VECTOR = 0.3  # of the reach: distance of a second point from the first one
BEYOND_EDGE = (1.01, 1.5)  # multiples of a vector to the edge that lead where a point may have no inverse
ROUNDED_NEIGHBOURS = (-8, -4, -2, -1, 1, 2, 4, 8)  # of a vector, in roundings of it


class RetractionFacts(Facts):
    """Measured facts of a retraction, at random, special and given points and tangent vectors of several lengths.

    The kinds of samples are ``zero``, ``tiny`` (lengths from ``eps^(3/4)`` to ``eps^(1/2)``), ``short`` (from there to
    ``eps^(1/5)``), ``inside`` (at most 1 long, and at most half way to the domain's edge), ``far`` (evenly up to the
    edge) and ``edge`` (``sqrt(eps)`` from the edge, relatively; 1e-2 for a domain that is not a closed form). Where the
    domain reaches farther than length 10, or than ``reach`` if that is more, this is taken for its edge.
    """

    kind = Retraction
    subject: Retraction

    def __init__(
        self,
        retraction: Retraction,
        *,
        order: int = 1,
        metric: Metric | None = None,
        reach: float = SAMPLE_REACH,
        seeds: Iterable[int] = SAMPLE_SEEDS,
        points: Iterable[Ambient] = (),
        tolerance: float | None = None,
    ) -> None:
        if order not in (1, 2):
            raise InvalidInputError(f"a retraction is checked to be of order 1 or 2, got order={order!r}")
        if not 0 < reach < np.inf:
            raise InvalidInputError(f"reach is a length, positive and finite, got {reach!r}; try reach={SAMPLE_REACH}")
        super().__init__(retraction, seeds, points, tolerance)
        self.order, self.reach = order, reach
        self.metric = EmbeddedMetric(self.manifold) if metric is None else metric
        self._edge = DomainEdge(retraction)
        self._longest = max(LONGEST_SAMPLE, reach)
        self._edges: dict[Site, float] = {}
        # These are made of compiled parts: compiling the inverse takes long.
        self.kernels |= {
            kernel.__name__: kernel for kernel in (self._invert, self._leave, self._vary_inverse, self._vary_midpoint)
        }
        self._pull_inverse, self._pull_midpoint = compiled(self._inverse_slope), compiled(self._midpoints)

    def draw(self, kind: str, site: Site) -> Sample:
        """``x`` and ``v`` with ``edge``, the length of the domain along ``v``, a point ``y`` near ``x`` and directions.

        ``w`` is a unit tangent vector, ``d`` and ``e`` are ambient directions of ``TM``, ``c`` is a covector of ``M``.
        """
        x, (_, frame) = site.x, self.sampler.at(site.x, site.seed)
        rng = np.random.default_rng(site.seed)
        u, w = direction(rng, frame[:1] if site.special else frame), direction(rng, frame)
        if site not in self._edges:
            self._edges[site] = self._edge(x, u, self._longest)
        edge, fraction, eps = self._edges[site], self.fraction(site), precision().eps
        length = {
            "zero": 0.0,
            "tiny": eps ** (0.75 - 0.25 * fraction),
            "short": eps ** (0.5 - 0.3 * fraction),
            "inside": fraction * min(MODERATE, edge / 2),
            "far": (1 - self._edge.margin) * fraction * edge,
            "edge": edge if edge == self._longest else (1 - self._edge.margin) * edge,
        }[kind]
        if kind in ("far", "edge"):
            # A gap that was not seen on the way to the edge.
            length = self._edge(x, u, length)
        c, *directions = rng.standard_normal((5, x.size)) / np.sqrt(x.size)
        y = self.sampler.near(x, rng, NEAR_VECTOR * min(1.0, edge, self.reach))
        step = precision().step * min(1.0, max(edge, self.reach))
        drawn = {"x": x, "v": length * u, "u": u, "w": w, "frame": frame, "edge": edge, "step": step, "y": y, "c": c}
        return {**drawn, "d": np.stack(directions[:2]), "e": np.stack(directions[2:])}

    def inverses(self, *kinds: str) -> Batch:
        """Inverses of the value at ``(x, v)`` and of the point ``y``, and where the latter leads."""
        return self.measure(self._invert, *kinds)

    def _invert(self, sample: Sample) -> Sample:
        move, preimage, x = self._edge.move, self._edge.preimage, sample["x"]
        value, to_y = move(x, sample["v"]), preimage(x, sample["y"])
        return {"value": value, "back": preimage(x, value), "to y": to_y, "there": move(x, to_y)}

    def inverses_of_far_points(self) -> Batch:
        """By how much the tangential part of the inverse of a point that may have none misses it; 0 where it is NaN."""
        return self.measure(self._leave, "zero")

    def _leave(self, sample: Sample) -> Sample:
        x, beyond = sample["x"], sample["edge"] * sample["u"]
        far = [-x, *(site.x for site in self.sites), *(self._edge.move(x, s * beyond) for s in BEYOND_EDGE)]
        far = [y for y in far if self.violation(y)[1] <= precision().half * (1 + np.max(np.abs(y)))]
        found = [self._edge.preimage(x, y) for y in far]
        # What leads to y from outside the tangent space, as y - x, is no inverse.
        misses = [self._miss(x, y, sample["frame"].T @ (sample["frame"] @ v)) for y, v in zip(far, found, strict=True)]
        worst = int(np.argmax(misses))
        return {"missed": misses[worst], "far": far[worst], "to far": found[worst]}

    def _miss(self, x: np.ndarray, y: np.ndarray, v: np.ndarray) -> float:
        if np.any(np.isnan(v)):
            return 0.0
        # As in Retraction.inverse: far out, the value from x has the rounding errors of both points' sizes.
        size = (1 + np.max(np.abs(x))) * (1 + np.max(np.abs(y)))

        def gap(k: int) -> float:
            there = self._edge.move(x, (1 + k * np.finfo(v.dtype).eps) * v)
            return float(np.nan_to_num(np.max(np.abs(there - y)) / size, nan=np.inf))

        # Far from x rounding may decide where an iteration ends: that a neighbour of v leads to y is enough.
        here = gap(0)
        return here if here <= precision().half else min(here, *map(gap, ROUNDED_NEIGHBOURS))

    def inverses_nearby(self, *kinds: str) -> Batch:
        """The derivative of ``<c, R_x^-1(y)>`` along a curve of ``x`` and ``y = R(x, v)``, and values on the curve."""
        return self.measure(self._vary_inverse, *kinds)

    def _vary_inverse(self, sample: Sample) -> Sample:
        curve = self._curve(sample)
        values = [self._edge.preimage(x, y) @ sample["c"] for x, y in zip(curve["xs"], curve["ys"], strict=True)]
        return {"slope": self._pull_inverse({**sample, **curve}), "values": np.stack(values)[None, 1:, None]}

    def midpoints_nearby(self) -> Batch:
        """Midpoints of ``x`` and ``y = R(x, v)`` with the way to both, and, as for inverses, a derivative and
        values."""
        return self.measure(self._vary_midpoint, "inside")

    def _vary_midpoint(self, sample: Sample) -> Sample:
        curve = self._curve(sample)
        slope, middles = self._pull_midpoint({**sample, **curve})
        to_x, to_y = (self._edge.preimage(middles[0], curve[ends][0]) for ends in ("xs", "ys"))
        return {"slope": slope, "values": (middles[1:] @ sample["c"])[None, :, None], "to x": to_x, "to y": to_y}

    def _curve(self, sample: Sample) -> Sample:
        """Points on curves through ``x`` along ``w`` and through ``y = R(x, v)``, these two first, and their
        directions."""
        move, x, frame = self._edge.move, sample["x"], sample["frame"]
        b = direction(np.random.default_rng(1), frame)
        times = sample["step"] * np.concatenate([[0.0], CENTRAL_NODES])
        # Both from x: beside y, which may be near an end of the manifold, steps may have to be shorter.
        xs, ys = (np.stack([move(x, v + t * u) for t in times]) for v, u in ((0 * b, sample["w"]), (sample["v"], b)))
        # Where the retraction is wrong to first order the curves have other directions than w and D_v R b.
        along_x, along_y = (differences(points[1:], sample["step"]) for points in (xs, ys))
        return {"xs": xs, "ys": ys, "along x": along_x, "along y": along_y}

    def _inverse_slope(self, sample: Sample) -> jax.Array:
        back = unflat(self.manifold)
        pull = jax.vjp(lambda x, y: flat(self.subject.preimage(back(x), back(y))), sample["xs"][0], sample["ys"][0])[1]
        return _pair(pull(sample["c"]), sample)

    def _midpoints(self, sample: Sample) -> tuple[jax.Array, jax.Array]:
        back, retraction = unflat(self.manifold), cast(MidpointRetraction, self.subject)

        def middle(x: Vector, y: Vector) -> Vector:
            return flat(retraction.midpoint(back(x), back(y)))

        pull = jax.vjp(middle, sample["xs"][0], sample["ys"][0])[1]
        return _pair(pull(sample["c"]), sample), jax.vmap(middle)(sample["xs"], sample["ys"])


def _pair(pulled: tuple[Vector, Vector], sample: Sample) -> jax.Array:
    """Derivative along the curves from that by both points, of shape ``(1,)``."""
    return jnp.atleast_1d(pulled[0] @ sample["along x"] + pulled[1] @ sample["along y"])
