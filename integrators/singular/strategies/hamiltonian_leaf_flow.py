"""Motion along the leaves of a level set of functions on T*Q: the flow of their Hamiltonian vector fields."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ....manifolds.numerics import ambient as vec
from ....manifolds.numerics.ambient import Ambient
from ....manifolds.numerics.tolerances import tolerance

Point = tuple[Ambient, Ambient]
Constraints = Callable[[Ambient, Ambient], Float[Array, " m"]]

# Step numbers of the modified midpoint rule, and the weights that cancel its errors of orders 2, 4 and 6.
_COUNTS = np.array([2.0, 4.0, 6.0, 8.0])
_WEIGHTS = np.array([np.prod([a**2 / (a**2 - b**2) for b in _COUNTS if b != a]) for a in _COUNTS])


def ambient_field(function: Callable[[Ambient, Ambient], Array], z: Point) -> Point:
    """``(df/dp, -df/dq)`` in the ambient space, for ``f = <p, g(q)> - l(q)`` with ``g`` tangent to Q.

    It represents the vector field ``X_f`` of ``T*Q``: covectors that differ by a normal one move alike, whatever
    extension of ``g`` and ``l`` off Q is differentiated. Project the covector to have the tangent representative again.
    """
    dq, dp = jax.tree.map(jnp.conj, jax.grad(lambda y: function(*y))(z))
    return dp, vec.scale(-1.0, dq)


def bracket(f: Point, g: Point) -> Array:
    """``{f, g}`` from the fields ``X_f`` and ``X_g``."""
    return vec.pairing(f[0], g[1]) - vec.pairing(f[1], g[0])


def bracket_size(f: Point, g: Point) -> Array:
    """The sizes of the parts of ``X_f`` and ``X_g`` in ``{f, g}``, which cancellation leaves: it scales as the bracket
    does."""
    return vec.size(f[0]) * vec.size(g[1]) + vec.size(f[1]) * vec.size(g[0])


def leaf_flow(constraints: Constraints, z: Point, time: Float[Array, " m"]) -> Point:
    """Flow of ``sum_a t_a phi_a`` for unit time: a move along the leaf through ``z`` of the level set of ``phi``.

    The level and the pullback of the symplectic form to it do not change. Exact to rounding, with its derivatives, for
    the moves of one step: a Runge-Kutta step of order 4 where that is enough, else the extrapolated midpoint rule of
    order 8 [Hairer, Norsett, Wanner 1993, II.9]. Covectors come up to normal ones.
    """

    @jax.jit
    def field(y: Point) -> Point:
        return ambient_field(lambda q, p: time @ constraints(q, p), y)

    first = field(z)
    second = field(vec.add(z, vec.scale(0.5, first)))
    third = field(vec.add(z, vec.scale(0.5, second)))
    fourth = field(vec.add(z, third))
    short = jax.tree.map(lambda a, *k: a + (k[0] + 2 * k[1] + 2 * k[2] + k[3]) / 6, z, first, second, third, fourth)
    enough = jnp.all(
        jnp.stack([jnp.all(leaf) for leaf in jax.tree.leaves(jax.tree.map(_project_linear, z, first, second))])
    )
    return jax.lax.cond(enough, lambda: short, lambda: _extrapolate(field, z))


def _project_linear(leaf: Array, first: Array, second: Array) -> Array:
    """Where a field changes half-way by so little of itself that the fourth power of that is rounding, or by rounding.

    Entry by entry: others, as a coordinate that does not enter, may be of any size.
    """
    rounding = tolerance(leaf.real, 1.0) * vec.largest(leaf)
    return jnp.abs(second - first) <= tolerance(leaf.real, 0.25) * jnp.abs(first) + rounding


def _extrapolate(field: Callable[[Point], Point], z: Point) -> Point:
    """The solution of ``z' = field(z)`` after unit time, to order 8."""

    def run(count: Array) -> Point:
        h = 1 / count

        def leap(pair: tuple[Point, Point], m: Array) -> tuple[tuple[Point, Point], None]:
            before, now = pair
            after = vec.add(before, vec.scale(2 * h, field(now)))
            return jax.tree.map(lambda a, b: jnp.where(m < count, a, b), (now, after), pair), None

        begin = z, vec.add(z, vec.scale(h, field(z)))
        (_, end), _ = jax.lax.scan(leap, begin, jnp.arange(1, int(_COUNTS[-1])))
        return end

    counts = jnp.asarray(_COUNTS, jax.tree.leaves(z)[0].real.dtype)
    return jax.tree.map(lambda leaf: jnp.tensordot(jnp.asarray(_WEIGHTS, leaf.dtype), leaf, 1), jax.vmap(run)(counts))
