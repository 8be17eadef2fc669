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

    At ``(x, v)``, on ``(a, adot)`` and ``(b, bdot)``, it is the rate of ``omega(x, a, b)`` along ``(v, adot, bdot)``;
    for the canonical form, ``omega(adot, b) + omega(a, bdot)``.

    In formulas ``d_T omega(w; a, b) = d/ds omega(x + s v; a + s adot, b + s bdot)`` at ``s = 0``.
    """

    def lifted(y: Any, a: Any, b: Any) -> Array:
        points, rates = zip(y, a, b, strict=True)
        return jax.jvp(form, points, rates)[1]

    return lifted


def difference(first: TwoForm, second: TwoForm) -> TwoForm:
    """``pr2* second - pr1* first`` on a product of two manifolds; ``Omega_12`` of the canonical form with itself.

    ``omega(x; a, b) = second(x_1; a_1, b_1) - first(x_0; a_0, b_0)``: points and vectors are pairs, the value is a
    scalar.
    """

    def form(x: Any, a: Any, b: Any) -> Array:
        return second(x[1], a[1], b[1]) - first(x[0], a[0], b[0])

    return form


def pullback_form(function: Callable[[Any], Any], form: TwoForm) -> TwoForm:
    """Pullback ``f* omega`` by a smooth map: ``omega(f(x); Df(x) a, Df(x) b)``.

    ``(f* omega)_x(a, b) = omega_f(x)(Df a, Df b)``. The value is a form: a function of a point and two vectors of its
    shape, with a scalar value.

    >>> area = lambda x, a, b: a[0] * b[1] - a[1] * b[0]
    >>> doubled = pullback_form(lambda x: 2.0 * x, area)
    >>> float(doubled(jnp.zeros(2), jnp.array([1.0, 0.0]), jnp.array([0.0, 1.0])))
    4.0
    """

    def pulled(x: Any, a: Any, b: Any) -> Array:
        y, push = jax.linearize(function, x)
        return form(y, push(a), push(b))

    return pulled


def form_matrix(form: TwoForm, x: Ambient, frame: Frame) -> Float[Array, "k k"]:
    """Matrix ``omega(E_i, E_j)`` of a two-form at ``x`` on the ``k`` vectors of a frame.

    ``W_ij = omega_x(E_i, E_j)``, of shape ``(k, k)`` and skew; the frame has its vectors along the first axis.

    >>> area = lambda x, a, b: a[0] * b[1] - a[1] * b[0]
    >>> form_matrix(area, jnp.zeros(2), jnp.eye(2)).tolist()
    [[0.0, 1.0], [-1.0, 0.0]]
    """
    return jax.vmap(lambda a: jax.vmap(lambda b: form(x, a, b))(frame))(frame)


def coordinates(frame: Frame, vectors: Frame) -> Float[Array, "k n"]:
    """Coordinates of ``k`` tangent vectors, one row each, in an orthonormal frame of ``n`` vectors."""
    return jax.vmap(lambda a: vec.components(frame, a))(vectors)
