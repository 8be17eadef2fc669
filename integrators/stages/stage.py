"""The stage: what one step of a discretization is unknown in, where it begins and ends, and what it costs."""

from abc import abstractmethod
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike

from ...manifolds import Manifold
from ...manifolds.numerics import ambient as vec
from ...manifolds.numerics.ambient import Ambient
from ...manifolds.numerics.attribute import attribute
from ...manifolds.numerics.tolerances import tolerance

Unknowns = Any

SMALLEST_SIZE = 0.25  # power of the machine epsilon


class Stage(eqx.Module):
    r"""One step of a discrete variational problem: a base class with the abstract methods below.

    Notes
    -----
    The generating function is :math:`S(y; p_0, p_1) = \langle p_1, R_2 \rangle - \langle p_0, R_1 \rangle - c(y)` with
    ``(R1, R2) = ends(y)`` and the cost ``c``. A step from ``(q0, p0)`` is a stationary point of ``S`` in ``y`` with
    ``R1 = q0``. A trajectory is the KKT system of :math:`\min \sum_k c(y_k)` subject to matching ends, with the
    costates as multipliers.

    Examples
    --------
    >>> method = SymplecticIntegrator(Gauss(2, Addition(Euclidean(1))))
    >>> isinstance(method.stage(lambda q, p: p @ p / 2, 0.1), Stage)
    True
    """

    @attribute
    @abstractmethod
    def manifold(self) -> Manifold:
        """The configuration manifold Q on which the ends of the step live."""

    @attribute
    @abstractmethod
    def dimension(self) -> int:
        """Number of coordinates of the unknowns."""

    @abstractmethod
    def frame(self, y: Unknowns) -> Any:
        """The basis data for ``move`` at ``y``, computed once for a chart because a basis may jump near ``y``.

        Parameters
        ----------
        y : pytree
            The unknowns.
        """

    @abstractmethod
    def move(self, y: Unknowns, frame: Any, d: Array) -> Unknowns:
        """The unknowns with coordinates ``d`` in the chart around ``y``: ``move(y, frame(y), 0) = y``.

        Parameters
        ----------
        y : pytree
            The unknowns.
        frame : pytree
            The result of ``frame(y)``.
        d : array of shape (dimension,)
            The coordinates.
        """

    @abstractmethod
    def sizes(self, y: Unknowns, p: Ambient) -> Array:
        """Typical positive sizes of the coordinates of ``move`` and of a costate, shape ``(dimension + n,)``.

        Parameters
        ----------
        y : pytree
            The unknowns.
        p : covector
            A costate at the base point.
        """

    @abstractmethod
    def base(self, y: Unknowns) -> Ambient:
        """The base point ``x`` of the step, in whose basis the costates of the step have coordinates.

        Parameters
        ----------
        y : pytree
            The unknowns.
        """

    @abstractmethod
    def ends(self, y: Unknowns) -> tuple[Ambient, Ambient]:
        """The two ends ``(R1, R2)`` of the step.

        Parameters
        ----------
        y : pytree
            The unknowns.
        """

    @abstractmethod
    def cost(self, y: Unknowns) -> Array:
        """The cost of the step.

        Parameters
        ----------
        y : pytree
            The unknowns.
        """

    @abstractmethod
    def predict(self, q0: Ambient, p0: Ambient, previous: Unknowns) -> Unknowns:
        """The first guess of the unknowns for a step from ``(q0, p0)``.

        Parameters
        ----------
        q0, p0 : point, covector
            The state before the step.
        previous : pytree
            The unknowns of the step before.
        """

    @abstractmethod
    def small_step_inverse(self) -> np.ndarray | None:
        """The inverse Jacobian of the equations of a step in the limit of a zero step, if it is known; otherwise
        None.

        Notes
        -----
        The equations are ``(R1 - q0, dS/dy)`` in the unknowns ``(y, p1)``, both in coordinates of one frame.
        """


def positive(size: Array) -> Array:
    """The ``size``, raised to a bound above rounding, because a costate far below one may be the rounding of zero."""
    return jnp.maximum(size, tolerance(size, SMALLEST_SIZE))


def first_sizes(*sizes: Array) -> Array:
    """Entry by entry the first of the sizes that is finite and not zero; one where none is.

    They are too small rather than too large: Newton's method notices where rounding lets no unknown be known as
    exactly.
    """
    found = jnp.ones_like(sizes[-1])
    for size in reversed(sizes):
        found = jnp.where(jnp.isfinite(size) & (size > jnp.finfo(size.dtype).tiny), size, found)
    return found


def phase_sizes(
    manifold: Manifold, energy: Callable[[Ambient, Ambient], Array], h: ArrayLike, x: Ambient, v: Ambient, p: Ambient
) -> tuple[Array, Array]:
    """Sizes of the coordinates of a position ``x`` and of a covector ``p`` there, array by array, for the motion ``v``
    in a step.

    Of an array of zeros those of the motion in a step, or of what the force adds in one to the covector; at rest those
    of the motion that begins in a step.
    """
    frame = manifold.basis(x)
    kick = manifold.projection(x, vec.scale(h, vec.gradient(lambda a: energy(a, p), x)))
    begun = manifold.projection(x, vec.scale(h, vec.gradient(lambda a: energy(x, a), vec.subtract(p, kick))))
    positions = [vec.coordinate_sizes(frame, a) for a in (x, v, begun)]
    covectors = [vec.coordinate_sizes(frame, a) for a in (p, kick)]
    whole = [jnp.broadcast_to(vec.size(a), covectors[0].shape) for a in (p, kick)]
    return first_sizes(*positions), first_sizes(*covectors, *whole)
