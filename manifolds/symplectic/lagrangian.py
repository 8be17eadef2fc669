"""Lagrangian submanifolds of presymplectic manifolds, and two constructions of Lagrangian submanifolds from maps.

Definitions and propositions: Barbero-Linan, Martin de Diego, "Presymplectic integrators for optimal control problems
via retraction maps", appendix.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, final

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array

from ...module import Module
from ..manifold import Manifold
from ..numerics import ambient as vec
from ..numerics.ambient import Ambient, Frame, is_traced
from ..numerics.errors import InvalidInputError, NotOnManifoldError
from ..numerics.precision import default_tolerance, working_precision
from ..numerics.rank import numerical_rank
from ..product import Product
from .forms import coordinates, difference, pullback_form
from .presymplectic import PresymplecticManifold

# Power of eps: largest value of the form on unit tangent vectors, relative to its largest on all: 1e-9.
ISOTROPY = 0.575


@final
class Immersion(Module):
    r"""An immersed submanifold :math:`i: L \to M` of a presymplectic manifold.

    Parameters
    ----------
    source : Manifold
        The manifold ``L``.
    target : PresymplecticManifold
        The manifold ``M`` with its form.
    function : callable
        The immersion ``i``, a smooth function of points of ``L``.

    Raises
    ------
    InvalidInputError
        For arguments of another kind.
    """

    source: Manifold
    target: PresymplecticManifold
    function: Callable[[Any], Any]

    def __check_init__(self) -> None:
        if not isinstance(self.source, Manifold):
            raise InvalidInputError(
                f"the source of an immersion is a manifold, got {self.source!r}; try Euclidean(1) for a curve"
            )
        _require_form(self.target)
        _require_function(self.function)

    def __call__(self, y: Ambient) -> Ambient:
        """The point ``i(y)`` of ``M``.

        Parameters
        ----------
        y : point
            A point of ``L``.
        """
        return self.function(y)

    def tangents(self, y: Ambient) -> Frame:
        """The images :math:`Di(y) e_k` of a basis of :math:`T_yL`: a frame of the tangent space of the image.

        Parameters
        ----------
        y : point
            A point of ``L``.
        """
        _, push = jax.linearize(self.function, y)
        return jax.vmap(push)(self.source.basis(y))


@dataclass(frozen=True)
class LagrangianVerdict:
    r"""The verdict whether a submanifold ``L`` is Lagrangian at a point, with its measurements.

    Attributes
    ----------
    isotropy : float
        Largest value of the form on two unit tangent vectors of ``L``, relative to the norm of the form.
    dimension : int
        The dimension of ``L``.
    rank : int
        The rank of the form.
    shared : int
        The dimension of the intersection of :math:`T_xL` with the kernel of the form.

    Notes
    -----
    ``L`` is Lagrangian if it is isotropic and :math:`\dim L = \mathrm{rank}/2 + \mathrm{shared}`.

    References
    ----------
    Barbero-Liñán and Martin de Diego, 2023, Definition 2.

    Examples
    --------
    >>> LagrangianVerdict(isotropy=0.0, dimension=1, rank=2, shared=1).reason
    'isotropic of dimension 1, expected rank / 2 + dim(TL and ker) = 2 / 2 + 1 = 2'
    """

    isotropy: float
    dimension: int
    rank: int
    shared: int

    @property
    def required(self) -> int:
        """The dimension of a Lagrangian submanifold with the same intersection with the kernel."""
        return self.rank // 2 + self.shared

    def __bool__(self) -> bool:
        return self.isotropy <= _isotropy_tolerance() and self.dimension == self.required

    @property
    def reason(self) -> str:
        """The verdict in words."""
        if not self.isotropy <= (limit := _isotropy_tolerance()):
            return (
                f"not isotropic: the pulled back form is {self.isotropy:.1e} (relative), expected at most {limit:.0e}"
            )
        formula = f"rank / 2 + dim(TL and ker) = {self.rank} / 2 + {self.shared} = {self.required}"
        if self.dimension != self.required:
            return f"isotropic of dimension {self.dimension}, expected {formula}"
        return f"Lagrangian: isotropic to {self.isotropy:.1e}, dimension {self.dimension} = {formula}"


def _isotropy_tolerance() -> float:
    return float(np.finfo(working_precision()).eps ** ISOTROPY)


def is_lagrangian(submanifold: Immersion, y: Ambient) -> LagrangianVerdict:
    r"""Whether ``i(L)`` is Lagrangian at ``i(y)``: :math:`i^* \omega = 0` and the dimension formula.

    Parameters
    ----------
    submanifold : Immersion
        The immersion ``i``.
    y : point
        A point of the source, of its shape.

    Returns
    -------
    LagrangianVerdict
        True or false, with the measurements.

    Raises
    ------
    InvalidInputError
        For another kind of submanifold.
    NotOnManifoldError
        If ``y`` is not on ``L``, or if ``i`` does not map it and its neighbours into ``M``.

    Notes
    -----
    The formula is :math:`\dim L = (\dim M - \dim \ker \omega)/2 + \dim(T_xL \cap \ker \omega)`.
    """
    if not isinstance(submanifold, Immersion):
        raise InvalidInputError(
            f"is_lagrangian takes an Immersion, got {submanifold!r}; try L_H(problem) or graph(f, M, N)"
        )
    space = submanifold.target.manifold
    if not (there := submanifold.source.contains(y)):
        raise NotOnManifoldError(f"y is not a point of the submanifold's source: {there.reason}")
    if not (there := space.contains(submanifold(y))):
        raise NotOnManifoldError(f"the immersion does not map y to a point of its target: {there.reason}")
    form, tangents, normal = (np.asarray(part) for part in _linear_data(submanifold, y))
    if not normal <= default_tolerance():
        raise NotOnManifoldError(
            f"the immersion leaves {space} at the image of y: its tangent vectors have a normal part of {normal:.3g} "
            "(relative), expected 0"
        )
    return lagrangian_subspace(form, tangents)


def lagrangian_subspace(form: np.ndarray, vectors: np.ndarray) -> LagrangianVerdict:
    """The verdict on the linear subspace that the rows of ``vectors`` span, for the matrix of a form."""
    dimension, span = numerical_rank(vectors).rank, _orthonormal_rows(vectors)
    size = np.max(np.abs(form), initial=0.0)
    isotropy = np.max(np.abs(span @ form @ span.T), initial=0.0) / size if size else 0.0
    seen = numerical_rank(span @ form / (size or 1.0), unit=1.0).rank
    return LagrangianVerdict(float(isotropy), dimension, numerical_rank(form).rank, dimension - seen)


def graph(function: Callable[[Any], Any], first: PresymplecticManifold, second: PresymplecticManifold) -> Immersion:
    r"""The graph :math:`\{(x, f(x))\}` in :math:`(M \times N, pr_2^* \omega_N - pr_1^* \omega_M)`.

    Parameters
    ----------
    function : callable
        ``f``, from points of ``M`` to points of ``N``.
    first, second : PresymplecticManifold
        ``M`` and ``N`` with their forms.

    Returns
    -------
    Immersion
        The graph; Lagrangian if ``f`` is a presymplectic diffeomorphism.

    Raises
    ------
    InvalidInputError
        For arguments of another kind.

    Notes
    -----
    The form vanishes on the graph if :math:`f^* \omega_N = \omega_M`.
    """
    _require_function(function)
    for space in (first, second):
        _require_form(space)
    space = PresymplecticManifold(Product(first.manifold, second.manifold), difference(first.form, second.form))
    return Immersion(first.manifold, space, lambda x: (x, function(x)))


def preimage(
    submanifold: Immersion, function: Callable[[Any], Any], inverse: Callable[[Any], Any], source: Manifold
) -> Immersion:
    r"""The preimage :math:`f^{-1}(L)` in :math:`(M, f^* \omega_N)` under a diffeomorphism ``f: M -> N``.

    Parameters
    ----------
    submanifold : Immersion
        ``L`` in ``(N, omega_N)``.
    function, inverse : callable
        ``f`` and its inverse.
    source : Manifold
        ``M``.

    Returns
    -------
    Immersion
        The preimage; Lagrangian if ``L`` is Lagrangian.

    Raises
    ------
    InvalidInputError
        For arguments of another kind, and if ``f`` after ``inverse`` is not the identity at a random point of ``L``.
    """
    if not isinstance(submanifold, Immersion):
        raise InvalidInputError(f"preimage takes an Immersion, got {submanifold!r}")
    _require_function(function)
    _require_function(inverse)

    @jax.jit  # one program: XLA would compile each operation by itself
    def missed(key: Array) -> tuple[Ambient, Array]:
        x = submanifold(submanifold.source.random_point(key))
        return x, vec.size(vec.subtract(function(inverse(x)), x)) / (1 + vec.size(x))

    x, gap = missed(jax.random.key(0))
    if not is_traced(gap) and not gap <= default_tolerance():
        raise InvalidInputError(
            f"inverse is not the inverse of f: f(inverse(x)) - x has size {gap:.3g} (relative) at x = {x}"
        )
    space = PresymplecticManifold(source, pullback_form(function, submanifold.target.form))
    return Immersion(submanifold.source, space, lambda y: inverse(submanifold(y)))


def _orthonormal_rows(vectors: np.ndarray) -> np.ndarray:
    _, _, directions = np.linalg.svd(vectors, full_matrices=False)
    return directions[: numerical_rank(vectors).rank]


def _require_form(space: object) -> None:
    if not isinstance(space, PresymplecticManifold):
        raise InvalidInputError(
            f"expected a manifold with a two-form, got {space!r}; try PresymplecticManifold(manifold, form)"
        )


def _require_function(function: object) -> None:
    if not callable(function):
        raise InvalidInputError(f"expected a function of points, got {function!r}")


@eqx.filter_jit
def _linear_data(submanifold: Immersion, y: Ambient) -> tuple[Array, Array, Array]:
    """Matrix of the form at ``i(y)``, coordinates of the submanifold's tangent vectors by rows, and their normal
    part."""
    x, space = submanifold(y), submanifold.target
    basis, tangents = space.manifold.basis(x), submanifold.tangents(y)
    rows = coordinates(basis, tangents)
    normal = vec.size(vec.subtract(tangents, vec.combine_each(basis, rows))) / (1 + vec.size(tangents))
    return space.matrix(x), rows, normal
