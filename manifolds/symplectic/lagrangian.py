"""Lagrangian submanifolds of presymplectic manifolds, and the two constructions of new ones from maps.

Definitions and propositions: Barbero-Linan, Martin de Diego, "Presymplectic integrators for optimal control problems via
retraction maps", appendix.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, final

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array

from ..manifold import Manifold
from ..numerics.ambient import Ambient, Frame
from ..numerics.rank import numerical_rank
from ..product import Product
from .forms import coordinates, difference, pullback_form
from .presymplectic import PresymplecticManifold

ISOTROPY = 1e-9  # largest value of the form on unit tangent vectors, relative to its largest on all of them


@final
class Immersion(eqx.Module):
    """An immersed submanifold ``i: L -> M`` of a presymplectic manifold: a smooth function on a manifold ``source``."""

    source: Manifold
    target: PresymplecticManifold
    function: Callable[[Any], Any]

    def __call__(self, y: Ambient) -> Ambient:
        """The point ``i(y)`` of ``M``."""
        return self.function(y)

    def tangents(self, y: Ambient) -> Frame:
        """Images ``Di(y) e_k`` of a basis of ``T_yL``: a frame of the tangent space of the image."""
        _, push = jax.linearize(self.function, y)
        return jax.vmap(push)(self.source.basis(y))


@dataclass(frozen=True)
class LagrangianVerdict:
    """Whether a submanifold is Lagrangian at a point, with what was measured there.

    ``isotropy``: largest value of the form on two unit tangent vectors of L, relative to its norm (0 if the form is zero).
    ``dimension`` of L; ``required`` by the dimension formula, ``rank / 2 + shared``, with ``rank`` of the form and ``shared`` the
    dimension of ``T_xL`` intersected with its kernel.
    """

    isotropy: float
    dimension: int
    rank: int
    shared: int

    @property
    def required(self) -> int:
        """Dimension of a Lagrangian submanifold that meets the kernel as this one does."""
        return self.rank // 2 + self.shared

    def __bool__(self) -> bool:
        return self.isotropy <= ISOTROPY and self.dimension == self.required

    @property
    def reason(self) -> str:
        """The verdict in words."""
        if not self.isotropy <= ISOTROPY:
            return f"not isotropic: the pulled back form is {self.isotropy:.1e} (relative), expected at most {ISOTROPY:.0e}"
        formula = f"rank / 2 + dim(TL and ker) = {self.rank} / 2 + {self.shared} = {self.required}"
        if self.dimension != self.required:
            return f"isotropic of dimension {self.dimension}, expected {formula}"
        return f"Lagrangian: isotropic to {self.isotropy:.1e}, dimension {self.dimension} = {formula}"


def is_lagrangian(submanifold: Immersion, y: Ambient) -> LagrangianVerdict:
    """Whether ``i(L)`` is Lagrangian at ``i(y)``: ``i* omega = 0`` and ``dim L = (dim M - dim ker)/2 + dim(T_xL and ker)``."""
    form, tangents = (np.asarray(part) for part in _linear_data(submanifold, y))
    return lagrangian_subspace(form, tangents)


def lagrangian_subspace(form: np.ndarray, vectors: np.ndarray) -> LagrangianVerdict:
    """The same for a linear subspace spanned by the rows of ``vectors`` and the matrix of a form."""
    dimension, span = numerical_rank(vectors).rank, _orthonormal_rows(vectors)
    size = np.max(np.abs(form), initial=0.0)
    isotropy = np.max(np.abs(span @ form @ span.T), initial=0.0) / size if size else 0.0
    seen = numerical_rank(span @ form / (size or 1.0), unit=1.0).rank
    return LagrangianVerdict(float(isotropy), dimension, numerical_rank(form).rank, dimension - seen)


def graph(function: Callable[[Any], Any], first: PresymplecticManifold, second: PresymplecticManifold) -> Immersion:
    """``{(x, f(x))}`` in ``(M x N, pr2* omega_N - pr1* omega_M)``: Lagrangian if ``f`` is a presymplectic diffeomorphism."""
    space = PresymplecticManifold(Product(first.manifold, second.manifold), difference(first.form, second.form))
    return Immersion(first.manifold, space, lambda x: (x, function(x)))


def preimage(
    submanifold: Immersion, function: Callable[[Any], Any], inverse: Callable[[Any], Any], source: Manifold
) -> Immersion:
    """``f^-1(L)`` in ``(M, f* omega_N)`` for a diffeomorphism ``f: M -> N``; Lagrangian if ``L`` is in ``(N, omega_N)``."""
    space = PresymplecticManifold(source, pullback_form(function, submanifold.target.form))
    return Immersion(submanifold.source, space, lambda y: inverse(submanifold(y)))


def _orthonormal_rows(vectors: np.ndarray) -> np.ndarray:
    _, _, directions = np.linalg.svd(vectors, full_matrices=False)
    return directions[: numerical_rank(vectors).rank]


@eqx.filter_jit
def _linear_data(submanifold: Immersion, y: Ambient) -> tuple[Array, Array]:
    """Matrix of the form at ``i(y)``, and coordinates of the tangent vectors of the submanifold, one row each."""
    x, space = submanifold(y), submanifold.target
    return space.matrix(x), coordinates(space.manifold.basis(x), submanifold.tangents(y))
