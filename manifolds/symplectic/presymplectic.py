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
    r"""A manifold ``M`` with a closed two-form; symplectic if the kernel of the form is zero.

    Parameters
    ----------
    manifold : Manifold
        The manifold.
    form : callable
        ``omega(x, a, b)``, a scalar function of a point and two tangent vectors. You ensure that it is closed.

    Notes
    -----
    The kernel is :math:`\{v : i_v \omega = 0\}`.
    """

    manifold: Manifold
    form: TwoForm

    def matrix(self, x: Ambient) -> Float[Array, "n n"]:
        r"""The matrix of :math:`\omega_x` in the orthonormal basis ``manifold.basis(x)``, shape ``(n, n)``.

        Parameters
        ----------
        x : point
            A point.
        """
        return form_matrix(self.form, x, self.manifold.basis(x))

    def rank(self, x: Ambient) -> int:
        r"""The rank of :math:`\omega_x`, an even number.

        Parameters
        ----------
        x : point
            A point.
        """
        return numerical_rank(np.asarray(_matrix(self, x))).rank

    def kernel(self, x: Ambient) -> Frame:
        r"""The orthonormal basis of the kernel of :math:`\omega_x`: leaves of shape ``(dimension of the kernel,
        *leaf)``.

        Parameters
        ----------
        x : point
            A point.
        """
        coefficients = jnp.asarray(null_space(np.asarray(_matrix(self, x))).T)
        return vec.combine_each(self.manifold.basis(x), coefficients)


@eqx.filter_jit
def _matrix(space: PresymplecticManifold, x: Ambient) -> Array:
    return space.matrix(x)
