"""Facts about Riemannian metrics: inner products, the covectors of vectors and back, energies, isometries."""

from collections.abc import Callable, Iterable, Mapping

import jax
import jax.numpy as jnp
import numpy as np

from ...manifolds import Metric
from ...manifolds.numerics.ambient import Ambient
from ..draws import direction
from ..numerics import along, flat, unflat
from ..precision import WORST, precision
from ..properties import SAMPLE_SEEDS, Facts, Sample, examine
from ..report import Comparison, Inapplicable, Report, fact
from ..sites import Site
from .manifold import max_violation


class MetricFacts(Facts):
    """Measured facts of a metric, at random, special and given points."""

    kind = Metric
    subject: Metric

    def __init__(
        self,
        metric: Metric,
        *,
        isometries: Mapping[str, Callable[[Ambient], Ambient]] | None = None,
        seeds: Iterable[int] = SAMPLE_SEEDS,
        points: Iterable[Ambient] = (),
        tolerance: float | None = None,
    ) -> None:
        super().__init__(metric, seeds, points, tolerance)
        self.isometries = dict(isometries or {})

    def draw(self, kind: str, site: Site) -> Sample:
        """The point with the basis there, unit tangent vectors ``v``, ``w``, ``d`` and a unit ambient covector
        ``p``."""
        _, basis = self.sampler.at(site.x, site.seed)
        rng = np.random.default_rng(site.seed)
        v, w, d = (direction(rng, basis) for _ in range(3))
        p = rng.standard_normal(site.x.size)
        return {"x": site.x, "basis": basis, "v": v, "w": w, "d": d, "p": p / np.linalg.norm(p)}


def _products(metric: Metric, sample: Sample) -> dict:
    """Inner products, covectors, vectors and energies at one point."""
    back, project = unflat(metric.manifold), metric.manifold.projection
    x, v, w, p = (back(sample[name]) for name in "xvwp")
    pairs = jax.vmap(jax.vmap(lambda a, b: metric.inner_product(x, back(a), back(b)), (None, 0)), (0, None))
    covector = metric.covector(x, v)
    return {
        "gram": pairs(sample["basis"], sample["basis"]),
        "product": metric.inner_product(x, v, w),
        "square": metric.inner_product(x, v, v),
        "covector": flat(covector),
        "projected": flat(project(x, covector)),
        "vector": flat(metric.vector(x, covector)),
        "vectors": jnp.stack([flat(metric.vector(x, a)) for a in (p, project(x, p))]),
        "tangent": flat(project(x, metric.vector(x, p))),
        "energy": metric.kinetic_energy(x, covector),
        "energies": jnp.stack([metric.kinetic_energy(x, p), metric.kinetic_energy(x, project(x, p))]),
    }


def _derivatives(metric: Metric, sample: Sample) -> dict:
    """Derivatives along ``d`` of ``g_x(P_x v, P_x w)`` and of the energy of ``p``, and values along it."""
    back, project = unflat(metric.manifold), metric.manifold.projection
    v, w, p = (back(sample[name]) for name in "vwp")

    def values(x: jax.Array) -> jax.Array:
        y = back(x)
        return jnp.stack([metric.inner_product(y, project(y, v), project(y, w)), metric.kinetic_energy(y, p)])

    return {
        "slope": jax.jacrev(values)(sample["x"]) @ sample["d"],
        "values": along(lambda t: values(sample["x"] + t * sample["d"]), precision().step),
    }


def _scale(f: dict) -> np.ndarray:
    """Mean square of the lengths of a basis: a metric may have any unit."""
    return np.maximum(np.trace(f["gram"], axis1=1, axis2=2) / max(f["gram"].shape[1], 1), np.finfo(float).tiny)


def _coordinates(f: dict, name: str) -> np.ndarray:
    return np.einsum("kij,kj->ki", f["basis"], f[name])


@fact
def inner_product_is_symmetric(facts: MetricFacts) -> Comparison:
    """``g_x(v, w) = g_x(w, v)``."""
    f = facts.measure(_products, "points")
    gram = f["gram"] / _scale(f)[:, None, None]
    return facts.compare("|g(v, w) - g(w, v)|", f, gram, np.swapaxes(gram, 1, 2), 10 * facts.tolerance)


@fact
def inner_product_is_bilinear(facts: MetricFacts) -> Comparison:
    """``g_x(v, w) = sum_ij v_i w_j g_x(E_i, E_j)`` for the coordinates of ``v``, ``w`` in the basis ``E_i``."""
    f = facts.measure(_products, "points")
    v, w = _coordinates(f, "v"), _coordinates(f, "w")
    expected = np.stack([np.einsum("ki,kij,kj->k", v, f["gram"], u) for u in (w, v)], axis=1)
    got, scale = np.stack([f["product"], f["square"]], axis=1), _scale(f)[:, None]
    return facts.compare("|g(v, w) - sum v_i w_j g(E_i, E_j)|", f, got / scale, expected / scale, 10 * facts.tolerance)


@fact
def inner_product_is_positive_definite(facts: MetricFacts) -> Comparison | Inapplicable:
    """``g_x(v, v) > 0`` for every tangent vector ``v`` that is not zero."""
    f = facts.measure(_products, "points")
    if facts.manifold.dimension == 0:
        return Inapplicable("there is no tangent vector")
    gram = np.nan_to_num(f["gram"] + np.swapaxes(f["gram"], 1, 2), nan=0.0) / 2
    values = np.linalg.eigvalsh(gram)
    ratio = values[:, 0] / np.maximum(np.max(np.abs(values), axis=1), np.finfo(float).tiny)

    def hint(k: int) -> str:
        lengths = f"the squares of the lengths of unit vectors go from {values[k, 0]:.3g} to {values[k, -1]:.3g}"
        return f"{lengths}; a metric is one on tangent vectors alone, but on all of them"

    # Of a metric that is degenerate the ratio is rounding; inertias of spacecraft have 1e-3 and more.
    return facts.bound("the smallest eigenvalue of g over the largest", f, ratio, precision().tiny, "at least", hint)


@fact
def covector_pairs_as_the_inner_product_does(facts: MetricFacts) -> Comparison:
    """``<covector(x, v), w> = g_x(v, w)`` for every tangent ``w``, and ``covector(x, v)`` is tangent."""
    f = facts.measure(_products, "points")
    expected = np.einsum("ki,kij->kj", _coordinates(f, "v"), f["gram"])
    got = np.concatenate([_coordinates(f, "covector"), f["covector"]], axis=1)
    expected, scale = np.concatenate([expected, f["projected"]], axis=1), _scale(f)[:, None]
    return facts.compare("|<covector(v), w> - g(v, w)|", f, got / scale, expected / scale, 10 * facts.tolerance)


@fact
def vector_inverts_covector(facts: MetricFacts) -> Comparison:
    """``vector(x, covector(x, v)) = v``, so that the kinetic energy belongs to the inverse of ``g_x``."""
    f = facts.measure(_products, "points")
    names = ("vector(x, covector(x, v))", "v")
    return facts.compare("|vector(covector(v)) - v|", f, f["vector"], f["v"], _conditioning(facts, f), names)


@fact
def energy_is_half_the_square_of_the_velocity(facts: MetricFacts) -> Comparison:
    """``kinetic_energy(x, covector(x, v)) = g_x(v, v) / 2``."""
    f = facts.measure(_products, "points")
    got, expected = (a[:, None] / _scale(f)[:, None] for a in (f["energy"], f["square"] / 2))
    names = ("the energy", "g(v, v) / 2")
    return facts.compare("|energy - g(v, v) / 2|", f, got, expected, _conditioning(facts, f), names)


def _conditioning(facts: MetricFacts, f: dict) -> np.ndarray:
    """The rounding of what goes through the inverse of ``g_x``."""
    condition = np.linalg.cond(np.nan_to_num(f["gram"])) if f["gram"].shape[1] else np.ones(len(f["gram"]))
    return np.minimum(10 * facts.tolerance * condition, WORST)


@fact
def energy_is_that_of_the_tangential_part(facts: MetricFacts) -> Comparison:
    """``kinetic_energy(x, p) = kinetic_energy(x, P_x p)`` for any ambient covector ``p``, as integrators give it."""
    f = facts.measure(_products, "points")
    energies = f["energies"] * _scale(f)[:, None]
    return facts.compare(
        "|K(p) - K(P p)|", f, energies[:, :1], energies[:, 1:], _conditioning(facts, f), ("K(p)", "K(P p)")
    )


@fact
def vector_is_that_of_the_tangential_part(facts: MetricFacts) -> Comparison:
    """``vector(x, p) = vector(x, P_x p)``, a tangent vector, for any ambient covector ``p``."""
    f = facts.measure(_products, "points")
    scale = _scale(f)[:, None]
    given, tangential = f["vectors"][:, 0], f["vectors"][:, 1]
    got, expected = (
        np.concatenate([given, given], axis=1) * scale,
        np.concatenate([tangential, f["tangent"]], axis=1) * scale,
    )
    return facts.compare("|vector(p) - vector(P p)|", f, got, expected, _conditioning(facts, f))


@fact
def derivatives_of_the_metric_are_those_of_differences(facts: MetricFacts) -> Comparison:
    """Reverse mode of ``g_x(P_x v, P_x w)`` and ``kinetic_energy(x, p)`` by ``x`` agrees with differences of their
    values."""
    f = facts.measure(_derivatives, "points")
    scale = np.stack([1 / _scale(g := facts.measure(_products, "points")), _scale(g)], axis=1)
    return facts.compare_slopes(
        "|D_x g - differences|", f, f["slope"] * scale, f["values"] * scale[:, None, None], precision().step
    )


@fact
def isometries_keep_inner_products(facts: MetricFacts) -> Comparison | Inapplicable:
    """Maps ``f`` that are said to be isometries have values on the manifold, and ``g_f(x)(Df v, Df w) = g_x(v, w)``."""
    if not facts.isometries:
        return Inapplicable("no isometry is claimed")

    def move(metric: Metric, sample: Sample) -> dict:
        back = unflat(metric.manifold)
        x, v, w = (back(sample[name]) for name in "xvw")

        def product(isometry: Callable[[Ambient], Ambient]) -> tuple[jax.Array, jax.Array]:
            y, push = jax.linearize(isometry, x)
            return metric.inner_product(y, push(v), push(w)), max_violation(metric.manifold, y)

        products, violations = map(jnp.stack, zip(*map(product, facts.isometries.values()), strict=True))
        return {"products": products, "violations": violations}

    f, g = facts.measure(move, "points"), facts.measure(_products, "points")
    scale = _scale(g)[:, None]
    got = np.concatenate([f["products"] / scale, f["violations"]], axis=1)
    expected = np.concatenate(
        [np.repeat(g["product"][:, None] / scale, len(facts.isometries), 1), 0 * f["violations"]], axis=1
    )

    def hint(k: int) -> str:
        gaps = np.max(np.abs(got - expected)[k].reshape(2, -1), axis=0)
        return f"the worst is the one named {list(facts.isometries)[int(np.argmax(np.nan_to_num(gaps, nan=np.inf)))]!r}"

    what = "|g(Df v, Df w) - g(v, w)|, or the violation of the equations,"
    return facts.bound(what, f, np.max(np.abs(got - expected), axis=1), min(100 * facts.tolerance, WORST), hint=hint)


METRIC_CHECKS = (
    inner_product_is_symmetric,
    inner_product_is_bilinear,
    inner_product_is_positive_definite,
    covector_pairs_as_the_inner_product_does,
    vector_inverts_covector,
    energy_is_half_the_square_of_the_velocity,
    energy_is_that_of_the_tangential_part,
    vector_is_that_of_the_tangential_part,
    derivatives_of_the_metric_are_those_of_differences,
    isometries_keep_inner_products,
)


def check_metric(
    metric: Metric,
    *,
    isometries: Mapping[str, Callable[[Ambient], Ambient]] | None = None,
    seeds: Iterable[int] = SAMPLE_SEEDS,
    points: Iterable[Ambient] = (),
    tolerance: float | None = None,
    only: Iterable[str] | str | None = None,
    skip: dict[str, str] | None = None,
    throw: bool = True,
) -> Report:
    """Measure whether an object is a Riemannian metric with consistent inner products, covectors and energies.

    Parameters
    ----------
    metric : Metric
        The metric.
    isometries : mapping of str to callable, optional
        Maps of the manifold to itself that are claimed to leave the metric invariant, such as ``{"left translation":
        lambda x: a @ x}``.
    seeds, points, tolerance, only, skip, throw
        As in ``check_manifold``; points have the shape of ``manifold.ambient``.

    Returns
    -------
    Report
        The outcomes.

    Raises
    ------
    ConformanceError
        If a fact does not hold and ``throw`` is true.
    """
    facts = MetricFacts(metric, isometries=isometries, seeds=seeds, points=points, tolerance=tolerance)
    return examine(facts, METRIC_CHECKS, only, skip, throw)
