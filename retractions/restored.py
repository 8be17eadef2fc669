"""The retraction that every manifold has: the ambient sum, brought back by the manifold's own Newton steps."""

from typing import final

import jax
import jax.numpy as jnp

from ..manifolds import Manifold
from ..manifolds.numerics import ambient as vec
from ..manifolds.numerics.ambient import Ambient
from ..manifolds.numerics.tolerances import tolerance
from .retraction import Retraction, nan_unless

NEWTON_STEPS = 10  # quadratically convergent: from a tenth to rounding in four
ON_IT = 0.75  # power of the machine epsilon: violations of a point that they led to, which grow with it
RESTORATION_DOMAIN = (
    0.25  # and of those that no point has, however large it is: of inequalities they do not grow with it
)


@final
class ProjectionByNewton(Retraction):
    """The point that ``manifold.restore`` reaches from ``x + v``: a retraction for a manifold without closed forms.

    Parameters
    ----------
    manifold : Manifold
        The manifold.

    Notes
    -----
    ``restore`` moves a point at distance ``e`` by :math:`O(e)` and is the identity on the manifold. :math:`x + t v`, at
    distance :math:`O(t^2)`, moves by :math:`O(t^2)`: the map is a retraction. Newton's method computes the inverse.
    Entries are NaN without convergence.

    References
    ----------
    Absil, Malick, Projection-like retractions on matrix manifolds, 2012.

    Examples
    --------
    >>> ProjectionByNewton(Sphere(2)).manifold
    Sphere(n=2)
    """

    manifold: Manifold

    def retract(self, x: Ambient, v: Ambient) -> Ambient:
        y, _ = jax.lax.scan(lambda y, _: (self.manifold.restore(y), None), vec.add(x, v), length=NEWTON_STEPS)
        worst = jnp.max(jnp.stack([jnp.zeros(()), *self.manifold.violations(y).values()]))
        allowed = jnp.minimum(tolerance(worst, ON_IT) * (1 + vec.size(y)), tolerance(worst, RESTORATION_DOMAIN))
        return nan_unless(worst <= allowed, y)
