"""Facts about retractions: axioms, order, inverse and domain, derivatives."""

from collections.abc import Callable, Iterable

import jax
import jax.numpy as jnp
import numpy as np

from ...manifolds import EmbeddedMetric, InvalidInputError, Metric
from ...retractions import Retraction, acceleration, adjoint, differentiated
from ..draws import DomainEdge, direction
from ..facts import SEEDS, TOLERANCE, Facts, Sample, examine, largest_entries
from ..numerics import NODES, Vector, flat, slope, unflat
from ..report import Batch, Comparison, Inapplicable, Report, fact
from .closed_forms import closed_forms_are_the_retraction_itself, midpoint_lies_midway
from .manifold import max_violation

# Longest tangent vector of a sample where the domain has no edge, and of those at which derivatives are measured.
LONGEST, MODERATE = 10.0, 1.0
# Spacing of the differences where the domain has radius 1: errors of order 6 and rounding divided by it are below 1e-10.
STEP = 2e-3
# Relative displacement of a value by which the effect of its rounding is measured.
ROUNDING = 1e-6
LENGTHS = 2.0 ** -np.arange(4, 15)
REACH = 0.1
NEAR = 0.3


class RetractionFacts(Facts):
    """What is measured of a retraction, at random points and tangent vectors of several lengths.

    The kinds of samples are ``zero``, ``tiny`` (lengths from 1e-12 to 1e-8), ``inside`` (at most 1 long, and at most half way to
    the domain's edge), ``far`` (evenly up to the edge) and ``edge`` (1e-8 from the edge, relatively; 1e-2 for a domain that is
    not a closed form). Where the domain reaches farther than length 10, or than ``reach`` if that is more, this is taken for
    its edge.
    """

    kind = Retraction
    subject: Retraction

    def __init__(
        self,
        retraction: Retraction,
        *,
        order: int = 1,
        metric: Metric | None = None,
        reach: float = REACH,
        seeds: Iterable[int] = SEEDS,
        tolerance: float = TOLERANCE,
    ) -> None:
        if order not in (1, 2):
            raise InvalidInputError(f"a retraction is checked to be of order 1 or 2, got order={order!r}")
        if not 0 < reach < np.inf:
            raise InvalidInputError(f"reach is a length, positive and finite, got {reach!r}; try reach={REACH}")
        super().__init__(retraction, seeds, tolerance)
        self.order, self.reach = order, reach
        self.metric = EmbeddedMetric(self.manifold) if metric is None else metric
        self._edge = DomainEdge(retraction)
        self._longest = max(LONGEST, reach)
        self._edges: dict[int, float] = {}
        self.kernels[self._invert.__name__] = self._invert  # made of compiled parts

    def draw(self, kind: str, seed: int) -> Sample:
        """``x`` and ``v`` with ``edge``, the length of the domain along ``v``, a point ``y`` near ``x`` and directions.

        ``w`` is a unit tangent vector, ``d`` and ``e`` are ambient directions of ``TM``, ``c`` is a covector of ``M``.
        """
        x, _, frame = self.sampler.point(seed)
        rng = np.random.default_rng(seed)
        u, w = direction(rng, frame), direction(rng, frame)
        if seed not in self._edges:
            self._edges[seed] = self._edge(x, u, self._longest)
        edge = self._edges[seed]
        fraction = (1 + self.seeds.index(seed)) / len(self.seeds)
        length = {
            "zero": 0.0,
            "tiny": 10.0 ** (-12 + 4 * fraction),
            "inside": fraction * min(MODERATE, edge / 2),
            "far": (1 - self._edge.margin) * fraction * edge,
            "edge": edge if edge == self._longest else (1 - self._edge.margin) * edge,
        }[kind]
        if kind in ("far", "edge"):
            # A gap that was not seen on the way to the edge.
            length = self._edge(x, u, length)
        c, *directions = rng.standard_normal((5, x.size)) / np.sqrt(x.size)
        y = self.sampler.near(x, rng, NEAR * min(1.0, edge, self.reach))
        step = STEP * min(1.0, max(edge, self.reach))
        drawn = {"x": x, "v": length * u, "u": u, "w": w, "frame": frame, "edge": edge, "step": step, "y": y, "c": c}
        return {**drawn, "d": np.stack(directions[:2]), "e": np.stack(directions[2:])}

    def inverses(self, *kinds: str) -> Batch:
        """Inverses of the value at ``(x, v)`` and of the point ``y``, and where the latter leads."""
        return self.measure(self._invert, *kinds)

    def _invert(self, sample: Sample) -> Sample:
        move, preimage, x = self._edge.move, self._edge.preimage, sample["x"]
        value, to_y = move(x, sample["v"]), preimage(x, sample["y"])
        return {"value": value, "back": preimage(x, value), "to y": to_y, "there": move(x, to_y)}


def flat_retraction(retraction: Retraction) -> Callable[[Vector, Vector], Vector]:
    """``R(x, v)`` on flat vectors, traced once for all that a kernel makes of it."""
    back = unflat(retraction.manifold)
    return jax.jit(lambda x, v: flat(retraction(back(x), back(v))))


def _values(retraction: Retraction, sample: Sample) -> dict:
    """Values at ``(x, v)``, alone and in a batch, and on short multiples of ``u``; violations at the value and off it."""
    move, x, v = flat_retraction(retraction), sample["x"], sample["v"]
    multiples = jnp.concatenate([v[None], 0 * v[None], jnp.asarray(LENGTHS)[:, None] * sample["u"]])
    value, at_zero, *short = jax.vmap(move)(jnp.broadcast_to(x, multiples.shape), multiples)
    off = ROUNDING * (1 + jnp.max(jnp.abs(value))) * jnp.concatenate([sample["d"], sample["e"]])
    nearby = value + jnp.concatenate([0 * value[None], off])
    violations = jax.vmap(lambda y: max_violation(retraction.manifold, unflat(retraction.manifold)(y)))(nearby)
    rest = {"violation": violations[0], "violations nearby": violations[1:]}
    return {"value": value, "at zero": at_zero, "short": jnp.stack(short), "alone": move(x, v), **rest}


def _first(retraction: Retraction, sample: Sample) -> dict:
    """First derivatives along the ambient direction ``d`` and the basis, and values along ``d``."""
    move, z, d = flat_retraction(retraction), jnp.stack([sample["x"], sample["v"]]), sample["d"]
    in_fibre = jnp.stack([0 * sample["frame"], sample["frame"]], axis=1)
    forward, *push = jax.vmap(lambda d: jax.jvp(lambda z: move(*z), (z,), (d,))[1])(jnp.concatenate([d[None], in_fibre]))
    return {
        "forward": forward,
        "push": jnp.stack(push) if push else in_fibre[:, 0],
        "values": jax.vmap(lambda t: move(*(z + t * d)))(sample["step"] * NODES),
    }


def _second(retraction: Retraction, sample: Sample) -> dict:
    """First and second derivatives along ``d``, and ``e``, of ``R`` and of ``<c, R>``, and gradients along ``d``."""
    move, z, d, c = flat_retraction(retraction), jnp.stack([sample["x"], sample["v"]]), sample["d"], sample["c"]
    gradient = jax.grad(lambda z: c @ move(*z))

    def along(z: jax.Array) -> Vector:
        return jax.jvp(lambda z: move(*z), (z,), (d,))[1]

    forward, twice_forward = jax.jvp(along, (z,), (sample["e"],))
    reverse, forward_reverse = jax.jvp(gradient, (z,), (d,))
    return {
        "forward": forward,
        "reverse": reverse,
        "forward forward": twice_forward,
        "forward reverse": forward_reverse,
        "gradients": jax.vmap(lambda t: gradient(z + t * d))(sample["step"] * NODES),
    }


def _reverse_twice(retraction: Retraction, sample: Sample) -> dict:
    """Second derivative of ``<c, R>`` along ``d``, by two reverse sweeps."""
    move, d, c = flat_retraction(retraction), sample["d"], sample["c"]
    gradient = jax.grad(lambda z: c @ move(*z))
    return {"reverse reverse": jax.grad(lambda z: jnp.sum(gradient(z) * d))(jnp.stack([sample["x"], sample["v"]]))}


def _adjoints(retraction: Retraction, sample: Sample) -> dict:
    """``DR[w]`` and ``DR*[c]`` as the library gives them."""
    back, x, v = unflat(retraction.manifold), sample["x"], sample["v"]
    return {
        "differentiated": flat(differentiated(retraction, back(x), back(v), back(sample["w"]))),
        "adjoint": flat(adjoint(retraction, back(x), back(v), back(sample["c"]))),
    }


def conditioning(push: np.ndarray) -> np.ndarray:
    """Norm of the inverse of ``D_v R`` at each sample: how much larger than errors of points those of tangent vectors are."""
    singular = np.linalg.svd(np.nan_to_num(push), compute_uv=False)
    return 1 / np.maximum(np.min(singular, axis=1, initial=1.0), np.finfo(float).tiny)


@fact
def zero_goes_to_the_base_point(facts: RetractionFacts) -> Comparison:
    """``R(x, 0) = x``."""
    f = facts.measure(_values, "zero")
    return facts.compare("|R(x, 0) - x|", f, f["at zero"], f["x"], facts.tolerance)


@fact
def derivative_at_zero_is_the_identity(facts: RetractionFacts) -> Comparison:
    """``D_v R(x, 0) = Id`` on the tangent space."""
    f = facts.measure(_first, "zero")
    return facts.compare("|D_v R(x, 0) E_i - E_i|", f, f["push"], f["frame"], facts.tolerance)


@fact
def error_against_the_straight_line_is_of_second_order(facts: RetractionFacts) -> Comparison:
    """The error ``R(x, t u) - x - t u`` is ``O(t^2)``, by values alone: the slope of its logarithm over that of ``t``."""
    f = facts.measure(_values, "zero")
    errors = np.linalg.norm(f["short"] - f["x"][:, None] - LENGTHS[None, :, None] * f["u"][:, None], axis=2)
    floor = 1e3 * np.finfo(float).eps * (1 + largest_entries(f["x"]))
    slopes = [slope(LENGTHS, e, limit) if np.all(np.isfinite(e)) else np.nan for e, limit in zip(errors, floor, strict=True)]
    return facts.bound("the slope of log error over log t", f, slopes, 1.8, "at least")


@fact
def values_stay_on_the_manifold(facts: RetractionFacts) -> Comparison:
    """``R(x, v)`` satisfies the manifold's equations to its rounding, for short vectors and up to the edge of the domain."""
    f = facts.measure(_values, "inside", "far", "edge")
    # Equations such as det x = 1 magnify the rounding of large values: by as much as they do a larger displacement.
    magnified = np.maximum(1.0 + largest_entries(f["value"]), np.max(f["violations nearby"], axis=1) / ROUNDING)
    return facts.bound("the largest violation of the equations", f, f["violation"], facts.tolerance * magnified)


@fact
def batches_are_the_values_one_by_one(facts: RetractionFacts) -> Comparison:
    """``R`` under ``vmap`` has the values of ``R`` at one point."""
    f = facts.measure(_values, "zero", "inside")
    return facts.compare("the difference of the two values", f, f["value"], f["alone"], facts.tolerance)


@fact
def order_is_as_claimed(facts: RetractionFacts) -> Comparison | Inapplicable:
    """A retraction of order 2 for a metric has curves ``R(x, t w)`` without covariant acceleration at ``t = 0``."""
    if facts.order == 1:
        return Inapplicable("order 2 is not claimed")

    def accelerations(retraction: Retraction, sample: Sample) -> dict:
        back = unflat(retraction.manifold)
        return {"acceleration": flat(acceleration(retraction, facts.metric, back(sample["x"]), back(sample["w"])))}

    f = facts.measure(accelerations, "zero")
    return facts.compare("the acceleration", f, f["acceleration"], 0.0, 10 * facts.tolerance)


@fact
def domain_reaches_as_far_as_expected(facts: RetractionFacts) -> Comparison:
    """Tangent vectors up to the length ``reach`` lie in the domain, where the inverse is known to be valid."""
    f = facts.measure(_values, "zero")
    return facts.bound("the length of the domain in a random direction", f, f["edge"], facts.reach, "at least")


@fact
def inverse_finds_the_tangent_vector(facts: RetractionFacts) -> Comparison:
    """``R_x^-1(R(x, v)) = v``, to rounding times the condition of ``R_x``."""
    return _inverse_error(facts, "zero", "inside")


@fact
def inverse_is_exact_up_to_the_edge_of_the_domain(facts: RetractionFacts) -> Comparison:
    """``R_x^-1(R(x, v)) = v`` up to 1e-8 from the edge of the domain, to rounding times the condition of ``R_x``."""
    return _inverse_error(facts, "far", "edge")


def _inverse_error(facts: RetractionFacts, *kinds: str) -> Comparison:
    f, push = facts.inverses(*kinds), facts.measure(_first, *kinds)["push"]
    limit = facts.tolerance * conditioning(push) * np.maximum(1.0, largest_entries(f["value"]))
    return facts.compare("|R_x^-1(R(x, v)) - v|", f, f["back"], f["v"], limit)


@fact
def inverse_keeps_the_accuracy_of_short_vectors(facts: RetractionFacts) -> Comparison:
    """``R_x^-1(R(x, v)) = v`` for vectors from 1e-12 to 1e-8 long, to the rounding of the two points."""
    f = facts.inverses("tiny")
    limit = 0.01 * facts.tolerance * (1 + largest_entries(f["x"])) ** 2
    return facts.bound("|R_x^-1(R(x, v)) - v|", f, largest_entries(f["back"] - f["v"]), limit)


@fact
def retraction_inverts_its_inverse(facts: RetractionFacts) -> Comparison:
    """``R(x, R_x^-1(y)) = y`` for points ``y`` that were found without the retraction."""
    f = facts.inverses("zero")
    return facts.compare("|R(x, R_x^-1(y)) - y|", f, f["there"], f["y"], facts.tolerance)


@fact
def inverse_is_tangent(facts: RetractionFacts) -> Comparison:
    """``R_x^-1(y)`` is a tangent vector at ``x``."""
    f = facts.inverses("zero")
    tangential = np.einsum("ki,kji,kjl->kl", f["to y"], f["frame"], f["frame"])
    return facts.compare("the normal part of R_x^-1(y)", f, tangential, f["to y"], facts.tolerance)


@fact
def first_derivatives_are_those_of_differences(facts: RetractionFacts) -> Comparison:
    """Forward mode along ambient directions agrees with differences of values, at ``v = 0`` and elsewhere."""
    f = facts.measure(_first, "zero", "inside")
    return facts.compare_slopes("|DR - differences|", f, f["forward"], f["values"], f["step"])


@fact
def reverse_mode_is_the_transpose_of_forward_mode(facts: RetractionFacts) -> Comparison:
    """``<D<c, R>, d> = <c, DR d>``, at ``v = 0`` and elsewhere."""
    f = facts.measure(_second, "zero", "inside")
    forward = np.einsum("ki,ki->k", f["c"], f["forward"])
    return facts.compare("|<D<c, R>, d> - <c, DR d>|", f, _along(f["reverse"], f["d"]), forward, facts.tolerance)


@fact
def second_derivatives_agree_in_every_mode(facts: RetractionFacts) -> Comparison:
    """Forward-over-forward, forward-over-reverse and reverse-over-reverse agree, at ``v = 0`` and elsewhere."""
    f, twice = facts.measure(_second, "zero", "inside"), facts.measure(_reverse_twice, "zero", "inside")
    curved = np.einsum("ki,ki->k", f["c"], f["forward forward"])
    got = np.stack([_along(hessian, f["e"]) for hessian in (f["forward reverse"], twice["reverse reverse"])], axis=1)
    return facts.compare("the largest difference of two modes", f, got, curved[:, None], 10 * facts.tolerance)


@fact
def second_derivatives_are_those_of_differences_of_gradients(facts: RetractionFacts) -> Comparison:
    """Second derivatives along ambient directions agree with differences of gradients, at ``v = 0`` and elsewhere."""
    f = facts.measure(_second, "zero", "inside")
    return facts.compare_slopes("|D2<c, R> d - differences|", f, f["forward reverse"], f["gradients"], f["step"])


@fact
def differentiated_retraction_is_the_derivative(facts: RetractionFacts) -> Comparison:
    """``DR[w]``, by its closed form if there is one, is the derivative of ``R`` along the fibre."""
    f, pushed = facts.measure(_adjoints, "zero", "inside"), _pushed(facts)
    return facts.compare("|DR[w] - d/ds R(x, v + s w)|", f, f["differentiated"], pushed, facts.tolerance)


@fact
def adjoint_pairs_as_the_derivative_does(facts: RetractionFacts) -> Comparison:
    """``<DR[w], c> = <w, DR*[c]>``, and ``DR*[c]`` is tangent at ``x``."""
    f, pushed = facts.measure(_adjoints, "zero", "inside"), _pushed(facts)
    tangential = np.einsum("ki,kji,kjl->kl", f["adjoint"], f["frame"], f["frame"])
    pulled = np.concatenate([_along(f["w"], f["adjoint"])[:, None], f["adjoint"]], axis=1)
    expected = np.concatenate([_along(pushed, f["c"])[:, None], tangential], axis=1)
    return facts.compare("|<w, DR*[c]> - <DR[w], c>|, or the normal part of DR*[c],", f, pulled, expected, facts.tolerance)


def _pushed(facts: RetractionFacts) -> np.ndarray:
    """``DR[w]`` by automatic differentiation, from the derivatives along the basis."""
    f = facts.measure(_first, "zero", "inside")
    return np.einsum("ki,kji,kjl->kl", f["w"], f["frame"], f["push"])


def _along(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Sums of products of entries, one a sample."""
    return np.sum((a * b).reshape(len(a), -1), axis=1)


RETRACTION_CHECKS = (
    zero_goes_to_the_base_point,
    derivative_at_zero_is_the_identity,
    error_against_the_straight_line_is_of_second_order,
    values_stay_on_the_manifold,
    batches_are_the_values_one_by_one,
    order_is_as_claimed,
    domain_reaches_as_far_as_expected,
    inverse_finds_the_tangent_vector,
    inverse_is_exact_up_to_the_edge_of_the_domain,
    inverse_keeps_the_accuracy_of_short_vectors,
    retraction_inverts_its_inverse,
    inverse_is_tangent,
    first_derivatives_are_those_of_differences,
    reverse_mode_is_the_transpose_of_forward_mode,
    second_derivatives_agree_in_every_mode,
    second_derivatives_are_those_of_differences_of_gradients,
    differentiated_retraction_is_the_derivative,
    adjoint_pairs_as_the_derivative_does,
    closed_forms_are_the_retraction_itself,
    midpoint_lies_midway,
)


def check_retraction(
    retraction: Retraction,
    *,
    order: int = 1,
    metric: Metric | None = None,
    reach: float = REACH,
    seeds: Iterable[int] = SEEDS,
    tolerance: float = TOLERANCE,
    only: Iterable[str] | str | None = None,
    skip: dict[str, str] | None = None,
    throw: bool = True,
) -> Report:
    """Measure whether an object is a retraction with the inverse, the domain and the derivatives that it says it has.

    ``order``: 2 if the retraction is claimed to be of second order for ``metric`` (default: that of the ambient space).
    ``reach``: tangent vectors up to this length, Euclidean in the ambient space, must lie in its domain. ``seeds``,
    ``tolerance``, ``only``, ``skip``, ``throw`` as in ``check_manifold``. Returns the report; raises ``ConformanceError`` if a
    fact does not hold, unless ``throw`` is false.
    """
    facts = RetractionFacts(retraction, order=order, metric=metric, reach=reach, seeds=seeds, tolerance=tolerance)
    return examine(facts, RETRACTION_CHECKS, only, skip, throw)
