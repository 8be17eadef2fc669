"""Facts about the first and second derivatives of retractions, in every mode of automatic differentiation."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np

from ...retractions import DifferentiatedRetraction, Retraction, differential_adjoint, differentiated
from ..numerics import Vector, along, flat, unflat
from ..properties import Facts, Sample
from ..report import Comparison, Inapplicable, fact


def flat_retraction(retraction: Retraction) -> Callable[[Vector, Vector], Vector]:
    """``R(x, v)`` on flat vectors, traced once for all that a kernel makes of it."""
    back = unflat(retraction.manifold)
    return jax.jit(lambda x, v: flat(retraction(back(x), back(v))))


def first_derivatives(retraction: Retraction, sample: Sample) -> dict:
    """First derivatives along the ambient direction ``d`` and the basis, and values along ``d``."""
    move, z, d = flat_retraction(retraction), jnp.stack([sample["x"], sample["v"]]), sample["d"]
    in_fibre = jnp.stack([0 * sample["frame"], sample["frame"]], axis=1)
    forward, *push = jax.vmap(lambda d: jax.jvp(lambda z: move(*z), (z,), (d,))[1])(
        jnp.concatenate([d[None], in_fibre])
    )
    return {
        "forward": forward,
        "push": jnp.stack(push) if push else in_fibre[:, 0],
        "values": along(lambda t: move(*(z + t * d)), sample["step"]),
    }


def _second(retraction: Retraction, sample: Sample) -> dict:
    """First and second derivatives along ``d``, and ``e``, of ``R`` and of ``<c, R>``, and gradients along ``d``."""
    move, z, d, c = flat_retraction(retraction), jnp.stack([sample["x"], sample["v"]]), sample["d"], sample["c"]
    gradient = jax.grad(lambda z: c @ move(*z))

    def push(z: jax.Array) -> Vector:
        return jax.jvp(lambda z: move(*z), (z,), (d,))[1]

    forward, twice_forward = jax.jvp(push, (z,), (sample["e"],))
    reverse, forward_reverse = jax.jvp(gradient, (z,), (d,))
    return {
        "forward": forward,
        "reverse": reverse,
        "forward forward": twice_forward,
        "forward reverse": forward_reverse,
        "gradients": along(lambda t: gradient(z + t * d), sample["step"]),
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
        "adjoint": flat(differential_adjoint(retraction, back(x), back(v), back(sample["c"]))),
    }


@fact
def first_derivatives_are_those_of_differences(facts: Facts) -> Comparison:
    """Forward mode along ambient directions agrees with differences of values, at ``v = 0``, near it and elsewhere."""
    f = facts.measure(first_derivatives, "zero", "short", "inside")
    return facts.compare_slopes("|DR - differences|", f, f["forward"], f["values"], f["step"])


@fact
def reverse_mode_is_the_transpose_of_forward_mode(facts: Facts) -> Comparison:
    """``<D<c, R>, d> = <c, DR d>``, at ``v = 0``, near it and elsewhere."""
    f = facts.measure(_second, "zero", "short", "inside")
    forward = np.einsum("ki,ki->k", f["c"], f["forward"])
    return facts.compare("|<D<c, R>, d> - <c, DR d>|", f, _along(f["reverse"], f["d"]), forward, facts.tolerance)


@fact
def second_derivatives_agree_in_every_mode(facts: Facts) -> Comparison:
    """Forward-over-forward, forward-over-reverse and reverse-over-reverse agree, at ``v = 0``, near it and
    elsewhere."""
    f, twice = (
        facts.measure(_second, "zero", "short", "inside"),
        facts.measure(_reverse_twice, "zero", "short", "inside"),
    )
    curved = np.einsum("ki,ki->k", f["c"], f["forward forward"])
    got = np.stack([_along(hessian, f["e"]) for hessian in (f["forward reverse"], twice["reverse reverse"])], axis=1)
    return facts.compare("the largest difference of two modes", f, got, curved[:, None], 10 * facts.tolerance)


@fact
def second_derivatives_are_those_of_differences_of_gradients(facts: Facts) -> Comparison:
    """Second derivatives along ambient directions agree with differences of gradients, at ``v = 0``, near it and
    elsewhere."""
    f = facts.measure(_second, "zero", "short", "inside")
    return facts.compare_slopes("|D2<c, R> d - differences|", f, f["forward reverse"], f["gradients"], f["step"])


@fact
def differentiated_retraction_is_the_derivative(facts: Facts) -> Comparison | Inapplicable:
    """``DR[w]`` by its closed form is the derivative of ``R`` along the fibre."""
    if not isinstance(facts.subject, DifferentiatedRetraction):
        return Inapplicable("there is no closed form of the derivative along the fibres")
    f, pushed = facts.measure(_adjoints, "zero", "inside"), _pushforward(facts)
    return facts.compare("|DR[w] - d/ds R(x, v + s w)|", f, f["differentiated"], pushed, facts.tolerance)


@fact
def adjoint_pairs_as_the_derivative_does(facts: Facts) -> Comparison | Inapplicable:
    """``<DR[w], c> = <w, DR*[c]>`` for the closed form of ``DR*``, and ``DR*[c]`` is tangent at ``x``."""
    if not isinstance(facts.subject, DifferentiatedRetraction):
        return Inapplicable("there is no closed form of the adjoint of the derivative")
    f, pushed = facts.measure(_adjoints, "zero", "inside"), _pushforward(facts)
    tangential = np.einsum("ki,kji,kjl->kl", f["adjoint"], f["frame"], f["frame"])
    pulled = np.concatenate([_along(f["w"], f["adjoint"])[:, None], f["adjoint"]], axis=1)
    expected = np.concatenate([_along(pushed, f["c"])[:, None], tangential], axis=1)
    return facts.compare(
        "|<w, DR*[c]> - <DR[w], c>|, or the normal part of DR*[c],", f, pulled, expected, facts.tolerance
    )


def _pushforward(facts: Facts) -> np.ndarray:
    """``DR[w]`` by automatic differentiation, from the derivatives along the basis."""
    f = facts.measure(first_derivatives, "zero", "inside")
    return np.einsum("ki,kji,kjl->kl", f["w"], f["frame"], f["push"])


def _along(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Sums of products of entries, one a sample."""
    return np.sum((a * b).reshape(len(a), -1), axis=1)


DERIVATIVE_CHECKS = (
    first_derivatives_are_those_of_differences,
    reverse_mode_is_the_transpose_of_forward_mode,
    second_derivatives_agree_in_every_mode,
    second_derivatives_are_those_of_differences_of_gradients,
    differentiated_retraction_is_the_derivative,
    adjoint_pairs_as_the_derivative_does,
)
