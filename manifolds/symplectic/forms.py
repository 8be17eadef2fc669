"""Two-forms on embedded manifolds, as functions of a point and two tangent vectors.

The canonical one of ``T*Q`` is ``CotangentBundle(Q).two_form``; the functions here make new forms from old ones.
"""

from collections.abc import Callable
from typing import Any

import jax
from jaxtyping import Array, Float

from ..numerics import ambient as vec
from ..numerics.ambient import Ambient, Frame

TwoForm = Callable[[Any, Any, Any], Array]


def tangent_lift(form: TwoForm) -> TwoForm:
    """Tangent (complete) lift ``d_T omega``, a two-form on ``TM``.

    At ``(x, v)``, on ``(a, adot)`` and ``(b, bdot)``, it is the rate of ``omega(x, a, b)`` along ``(v, adot, bdot)``; for the
    canonical form, ``omega(adot, b) + omega(a, bdot)``.
    """

    def lifted(y: Any, a: Any, b: Any) -> Array:
        points, rates = zip(y, a, b, strict=True)
        return jax.jvp(form, points, rates)[1]

    return lifted


def difference(first: TwoForm, second: TwoForm) -> TwoForm:
    """``pr2* second - pr1* first`` on a product of two manifolds; ``Omega_12`` of the canonical form with itself."""

    def form(x: Any, a: Any, b: Any) -> Array:
        return second(x[1], a[1], b[1]) - first(x[0], a[0], b[0])

    return form


def pullback_form(function: Callable[[Any], Any], form: TwoForm) -> TwoForm:
    """Pullback ``f* omega`` by a smooth map: ``omega(f(x); Df(x) a, Df(x) b)``."""

    def pulled(x: Any, a: Any, b: Any) -> Array:
        y, push = jax.linearize(function, x)
        return form(y, push(a), push(b))

    return pulled


def form_matrix(form: TwoForm, x: Ambient, frame: Frame) -> Float[Array, "k k"]:
    """Matrix ``omega(E_i, E_j)`` of a two-form at ``x`` on the ``k`` vectors of a frame."""
    return jax.vmap(lambda a: jax.vmap(lambda b: form(x, a, b))(frame))(frame)


def coordinates(frame: Frame, vectors: Frame) -> Float[Array, "k n"]:
    """Coordinates of ``k`` tangent vectors, one row each, in an orthonormal frame of ``n`` vectors."""
    return jax.vmap(lambda a: vec.components(frame, a))(vectors)
