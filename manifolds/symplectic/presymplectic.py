"""A manifold with a closed two-form, which may be degenerate."""

from typing import final

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...module import Module
from ..manifold import Manifold
from ..numerics import ambient as vec
from ..numerics.ambient import Ambient, Frame
from ..numerics.rank import null_space, numerical_rank
from .forms import TwoForm, form_matrix


@final
class PresymplecticManifold(Module):
    """A manifold ``M`` with a closed two-form ``omega``, a function ``form(x, a, b)`` of a point and two tangent
    vectors.

    Symplectic where the kernel ``{v : i_v omega = 0}`` is zero. That the form is closed is the caller's promise.

    ``form`` takes a point and two vectors of its shape, and returns a scalar.
    """

    manifold: Manifold
    form: TwoForm

    def matrix(self, x: Ambient) -> Float[Array, "n n"]:
        """Matrix of ``omega_x`` in the orthonormal basis ``manifold.basis(x)``."""
        return form_matrix(self.form, x, self.manifold.basis(x))

    def rank(self, x: Ambient) -> int:
        """Rank of ``omega_x``, an even number."""
        return numerical_rank(np.asarray(_matrix(self, x))).rank

    def kernel(self, x: Ambient) -> Frame:
        """Orthonormal basis of the kernel of ``omega_x``: leaves of shape ``(dimension of the kernel, *leaf)``."""
        coefficients = jnp.asarray(null_space(np.asarray(_matrix(self, x))).T)
        return vec.combine_each(self.manifold.basis(x), coefficients)


@eqx.filter_jit
def _matrix(space: PresymplecticManifold, x: Ambient) -> Array:
    return space.matrix(x)
