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
    r"""The tangent (complete) lift :math:`d_T \omega` of a two-form, a two-form on ``TM``.

    Parameters
    ----------
    form : callable
        ``omega(x, a, b)``, a scalar function of a point and two vectors of its shape.

    Returns
    -------
    callable
        The form on ``TM``: a function of a point ``(x, v)`` and two vectors ``(a, adot)`` and ``(b, bdot)``.

    Notes
    -----
    :math:`d_T \omega((x, v); (a, \dot a), (b, \dot b)) = \frac{d}{ds} \omega(x + s v; a + s \dot a, b + s \dot b)` at
    ``s = 0``. For the canonical form it is :math:`\omega(\dot a, b) + \omega(a, \dot b)`.
    """

    def lifted(y: Any, a: Any, b: Any) -> Array:
        points, rates = zip(y, a, b, strict=True)
        return jax.jvp(form, points, rates)[1]

    return lifted


def difference(first: TwoForm, second: TwoForm) -> TwoForm:
    r"""The form :math:`pr_2^* \omega_2 - pr_1^* \omega_1` on a product of two manifolds.

    Parameters
    ----------
    first, second : callable
        The forms, scalar functions of a point and two vectors.

    Returns
    -------
    callable
        The form: points and vectors are pairs, the value is a scalar.

    Notes
    -----
    :math:`\omega(x; a, b) = \omega_2(x_1; a_1, b_1) - \omega_1(x_0; a_0, b_0)`; :math:`\Omega_{12}` for the canonical
    form with itself.
    """

    def form(x: Any, a: Any, b: Any) -> Array:
        return second(x[1], a[1], b[1]) - first(x[0], a[0], b[0])

    return form


def pullback_form(function: Callable[[Any], Any], form: TwoForm) -> TwoForm:
    r"""The pullback :math:`f^* \omega` of a two-form by a smooth map.

    Parameters
    ----------
    function : callable
        The map ``f`` of points.
    form : callable
        ``omega(x, a, b)``, a scalar.

    Returns
    -------
    callable
        The form :math:`(f^* \omega)_x(a, b) = \omega_{f(x)}(Df\,a, Df\,b)`.

    Examples
    --------
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
    r"""The matrix :math:`W_{ij} = \omega_x(E_i, E_j)` of a two-form on the vectors of a frame.

    Parameters
    ----------
    form : callable
        ``omega(x, a, b)``, a scalar.
    x : point
        A point.
    frame : frame
        Tangent vectors, leaves of shape ``(k, *leaf)``.

    Returns
    -------
    Array of shape (k, k)
        The skew matrix.

    Examples
    --------
    >>> area = lambda x, a, b: a[0] * b[1] - a[1] * b[0]
    >>> form_matrix(area, jnp.zeros(2), jnp.eye(2)).tolist()
    [[0.0, 1.0], [-1.0, 0.0]]
    """
    return jax.vmap(lambda a: jax.vmap(lambda b: form(x, a, b))(frame))(frame)


def coordinates(frame: Frame, vectors: Frame) -> Float[Array, "k n"]:
    """Coordinates of ``k`` tangent vectors, one row each, in an orthonormal frame of ``n`` vectors."""
    return jax.vmap(lambda a: vec.components(frame, a))(vectors)
