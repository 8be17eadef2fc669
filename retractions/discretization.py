"""Discretization maps: from a tangent vector to the two ends of a step."""

from abc import abstractmethod
from typing import final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool

from ..errors import concise
from ..manifolds import DomainError, InvalidInputError, Manifold
from ..manifolds.numerics import ambient as vec
from ..manifolds.numerics.ambient import Ambient
from ..manifolds.numerics.attribute import attribute
from ..manifolds.numerics.root import find_root
from ..module import Module
from .constructions import PowerRetraction, ProductRetraction
from .retraction import MidpointRetraction, Retraction, is_reached, nan_unless

Pair = tuple[Ambient, Ambient]


class DiscretizationMap(Module):
    r"""A map of a tangent vector, base point and velocity times step, to the two ends of a step: a base class.

    Notes
    -----
    :math:`R_d = (R_1, R_2): TM \to M \times M` with :math:`R_d(x, 0) = (x, x)` and
    :math:`D_v R_2(x, 0) - D_v R_1(x, 0) = \mathrm{Id}`.

    References
    ----------
    Barbero-Liñán and Martin de Diego, Retraction maps: a seed of geometric integrators, 2022.

    Examples
    --------
    >>> R_d = Theta(Addition(Euclidean(1)), 0.25)
    >>> [end.tolist() for end in R_d(jnp.array([1.0]), jnp.array([0.4]))]
    [[0.9], [1.3]]
    """

    __hash__ = vec.shared_hash  # for jax.jit of a method

    @attribute
    @abstractmethod
    def theta(self) -> float:
        """The place of the base point in the step: 0 at its start, 1 at its end."""

    @attribute
    @abstractmethod
    def retraction(self) -> Retraction:
        """A retraction of the same manifold, by which solvers move base points."""

    @abstractmethod
    def __call__(self, x: Ambient, v: Ambient) -> Pair:
        """The two ends :math:`(R_1(x, v), R_2(x, v))`.

        Parameters
        ----------
        x : point
            The base point.
        v : tangent vector
            The velocity times the step.
        """

    @property
    def manifold(self) -> Manifold:
        """The manifold that is discretized."""
        return self.retraction.manifold

    @property
    def stages(self) -> int:
        """The number of stages of a step: 1."""
        return 1

    @property
    def order(self) -> int:
        """The order of convergence at the ends of the steps.

        Every map has order 1; a subclass that is symmetric has to return 2.
        """
        return 1

    @property
    def nodes(self) -> np.ndarray:
        """The place of the stage in the step, shape ``(1,)``."""
        return np.array([float(self.theta)])

    @property
    def weights(self) -> np.ndarray:
        """The weight of the stage in the step, shape ``(1,)``."""
        return np.ones(1)

    @property
    def discretization_map(self) -> "DiscretizationMap":
        """The map itself, as a collocation method of one stage has one."""
        return self

    def preimage(self, x0: Ambient, x1: Ambient) -> Pair:
        """The pair ``(x, v)`` with ``R_d(x, v) = (x0, x1)``, by Newton's method; entries are NaN without
        convergence.

        Parameters
        ----------
        x0, x1 : point
            The ends.
        """
        return newton_preimage(self, x0, x1)

    def inverse(self, x0: Ambient, x1: Ambient) -> Pair:
        """The pair ``(x, v)`` with ``R_d(x, v) = (x0, x1)``.

        Parameters
        ----------
        x0, x1 : point
            The ends.

        Raises
        ------
        DomainError
            If none is found; under ``jit`` and ``vmap`` the entries are NaN instead.
        """
        z = self.preimage(x0, x1)
        if not vec.is_traced(x0, x1, z):
            ends = self(*z)
            if not _are_reached(self.manifold, (x0, x1), ends, z):
                gap = vec.size(vec.subtract(ends, (x0, x1)))
                raise DomainError(
                    f"the two points are outside the image of {type(self).__name__}: its inverse misses them by "
                    f"{float(gap):.3g}, expected 0; take points nearer to each other"
                )
        return z


def _are_reached(manifold: Manifold, wanted: Pair, ends: Pair, z: Pair) -> Bool[Array, ""]:
    """Whether both ends of a step ``z`` are the wanted ends."""
    return is_reached(manifold, wanted[0], ends[0], *z) & is_reached(manifold, wanted[1], ends[1], *z)


def newton_preimage(discretization: DiscretizationMap, x0: Ambient, x1: Ambient) -> Pair:
    """Inverse of any discretization map by Newton's method on the tangent bundle, started at ``x0``."""
    manifold, step = discretization.manifold, discretization.retraction
    ends = jax.lax.stop_gradient((x0, x1))
    base, chord = ends[0], manifold.projection(ends[0], vec.subtract(ends[1], ends[0]))
    frame, frames = manifold.basis(base), (manifold.basis(ends[0]), manifold.basis(ends[1]))

    def point(c: Array) -> Pair:
        half = c.size // 2
        x = step(base, vec.combine(frame, c[:half]))
        return x, manifold.projection(x, vec.combine(frame, c[half:]))

    def residual(c: Array) -> Array:
        y0, y1 = discretization(*point(c))
        gaps = vec.components(frames[0], vec.subtract(y0, x0)), vec.components(frames[1], vec.subtract(y1, x1))
        return jnp.concatenate(gaps)

    velocity = vec.components(frame, chord)
    start = jnp.concatenate([discretization.theta * velocity, velocity])
    c, converged = find_root(residual, start)
    z = point(c)
    return nan_unless(converged & _are_reached(manifold, (x0, x1), discretization(*z), z), z)


@final
class Theta(DiscretizationMap):
    r"""The theta family of discretization maps, :math:`R_d(x, v) = (A(x, -\theta v), B(x, (1 - \theta) v))`.

    Parameters
    ----------
    retraction : Retraction
        The retraction ``A``.
    theta : float
        A number in [0, 1]: 0 is Euler, 1/2 midpoint, 1 backward Euler.
    forward : Retraction, optional
        The retraction ``B``; by default ``A``.

    Raises
    ------
    InvalidInputError
        For other retractions, retractions of two manifolds, and ``theta`` outside [0, 1].

    Notes
    -----
    ``theta = 1/2`` with ``A = B`` is symmetric, hence of order 2.

    Examples
    --------
    >>> Theta(Cayley(SO(3)), 0.5).manifold
    SO(n=3)
    """

    backward: Retraction
    other: Retraction | None
    theta: float = eqx.field(static=True)

    def __init__(self, retraction: Retraction, theta: float, forward: Retraction | None = None) -> None:
        for given in (retraction, forward or retraction):
            if not isinstance(given, Retraction):
                raise InvalidInputError(
                    f"a discretization map is made from retractions, got {given!r}; try default_retraction(manifold)"
                )
        if not 0 <= theta <= 1:
            raise InvalidInputError(f"theta must lie in [0, 1], got {theta}")
        # By class and shape only: the data of a manifold may be traced where this runs.
        kinds = [(type(r.manifold), r.manifold.ambient) for r in (retraction, forward or retraction)]
        if kinds[0] != kinds[1]:
            raise InvalidInputError(
                f"both retractions must act on one manifold, got {retraction.manifold} and "
                f"{(forward or retraction).manifold}"
            )
        self.backward, self.other, self.theta = retraction, forward, float(theta)

    @property
    def forward(self) -> Retraction:
        """The retraction ``B`` of the second end."""
        return self.backward if self.other is None else self.other

    @property
    def retraction(self) -> Retraction:
        return self.forward

    @property
    def order(self) -> int:
        return 2 if self.theta == 0.5 and self.other is None else 1

    def __call__(self, x: Ambient, v: Ambient) -> Pair:
        if self.other is None and self.theta == 0.5:
            return self.backward.both_ways(x, vec.scale(0.5, v))
        start = x if self.theta == 0 else self.backward(x, vec.scale(-self.theta, v))
        end = x if self.theta == 1 else self.forward(x, vec.scale(1 - self.theta, v))
        return start, end

    def preimage(self, x0: Ambient, x1: Ambient) -> Pair:
        """The inverse, in closed form for Euler, backward Euler, and midpoint with known midpoints; otherwise by
        Newton's method.
        """
        if self.theta == 0:
            return x0, self.forward.preimage(x0, x1)
        if self.theta == 1:
            return x1, vec.scale(-1.0, self.backward.preimage(x1, x0))
        if self.other is None and isinstance(self.backward, ProductRetraction):
            parts = zip(self.backward.factors, x0, x1, strict=True)
            z = [Theta(factor, self.theta).preimage(y0, y1) for factor, y0, y1 in parts]
            return tuple(x for x, _ in z), tuple(v for _, v in z)
        if self.other is None and isinstance(self.backward, PowerRetraction):
            return jax.vmap(Theta(self.backward.factor, self.theta).preimage)(x0, x1)
        if self.theta == 0.5 and self.other is None and isinstance(self.backward, MidpointRetraction):
            x = self.backward.midpoint(x0, x1)
            return x, vec.scale(2.0, self.backward.preimage(x, x1))
        return newton_preimage(self, x0, x1)


@concise
def Euler(retraction: Retraction) -> Theta:
    """The explicit Euler map :math:`R_d(x, v) = (x, R(x, v))`.

    Parameters
    ----------
    retraction : Retraction
        The retraction ``R``.

    Returns
    -------
    Theta
        The map with ``theta = 0``, of order 1.

    Examples
    --------
    >>> Euler(Cayley(SO(3))).theta
    0.0
    """
    return Theta(retraction, 0.0)


@concise
def Midpoint(retraction: Retraction) -> Theta:
    """The midpoint map :math:`R_d(x, v) = (R(x, -v/2), R(x, v/2))`: symmetric, of order 2.

    Parameters
    ----------
    retraction : Retraction
        The retraction ``R``.

    Returns
    -------
    Theta
        The map with ``theta = 1/2``.

    Examples
    --------
    >>> Midpoint(Cayley(SO(3))).theta
    0.5
    """
    return Theta(retraction, 0.5)


@final
class Adjoint(DiscretizationMap):
    r"""The adjoint :math:`(x, v) \mapsto (R_2(x, -v), R_1(x, -v))` of a discretization map.

    Parameters
    ----------
    inner : DiscretizationMap
        The map. It is symmetric if it is its own adjoint.

    Examples
    --------
    >>> Adjoint(Euler(Addition(Euclidean(1)))).theta
    1.0
    """

    inner: DiscretizationMap

    @property
    def retraction(self) -> Retraction:
        return self.inner.retraction

    @property
    def theta(self) -> float:
        return 1 - self.inner.theta

    @property
    def order(self) -> int:
        return self.inner.order

    def __call__(self, x: Ambient, v: Ambient) -> Pair:
        start, end = self.inner(x, vec.scale(-1.0, v))
        return end, start

    def preimage(self, x0: Ambient, x1: Ambient) -> Pair:
        x, v = self.inner.preimage(x1, x0)
        return x, vec.scale(-1.0, v)
