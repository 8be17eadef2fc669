"""The record of an extremal's derivatives."""

from dataclasses import dataclass
from typing import Any, final

import jax
import numpy as np

from ....manifolds import ConvergenceError
from ....manifolds.numerics.tolerances import EPS
from ...problem.point_layout import PointLayout
from ...reporting.records import shapes
from .parametric_sensitivity import Derivatives
from .record import Solution

CLEAR = 1e7 * EPS  # a smaller pivot, with rows scaled to size one, leaves less than six digits of a derivative


@final
@dataclass(frozen=True, eq=False)
class Derivative:
    """The derivative of an extremal with respect to a number, or to an array, whose axes lead.

    Attributes
    ----------
    cost : float or array
        The derivative of the cost.
    states, costates : array, or tuple of arrays
        Tangent vectors of the ambient space at the nodes, on the axis behind the leading axes.
    controls : array, or tuple of arrays
        The derivatives at the stages.
    """

    cost: Any
    states: Any
    costates: Any
    controls: Any

    def __repr__(self) -> str:
        return f"Derivative({', '.join(f'{name}={shapes(value)}' for name, value in vars(self).items())})"


@final
@dataclass(frozen=True, eq=False)
class Sensitivity:
    """The derivatives of an extremal with respect to its ends, horizon and parameters.

    Attributes
    ----------
    start, end : Derivative
        With respect to the coordinates of the ends in ``manifold.basis(start)`` and ``manifold.basis(end)``, leading
        axis ``n``; zero for free ends.
    horizon : Derivative or None
        With respect to the horizon, with proportional steps; None if it is free.
    parameters : pytree of Derivative, or None
        One ``Derivative`` for each array of the parameters; None if there are none, or one is free.

    Notes
    -----
    :math:`dy = -K^{-1} dF` with the KKT system :math:`F(y) = 0` of the extremal. The derivative of the cost is the
    derivative of the Lagrangian (envelope theorem): ``start.cost`` is :math:`-p_0` in coordinates.
    """

    start: Derivative
    end: Derivative
    horizon: Derivative | Any
    parameters: Any

    @classmethod
    def of(cls, found: Derivatives, layouts: tuple[PointLayout, PointLayout], n: int, parameters: Any) -> "Sensitivity":
        """The record from the columns of one extremal.

        Parameters
        ----------
        found, layouts, n, parameters : Derivatives, pair of PointLayout, int, pytree
            The columns, the free entries of both ends, the dimension, and the parameters.
        """
        state, control = layouts

        def part(begin: int, shape: tuple[int, ...]) -> Derivative:
            places = slice(begin, begin + int(np.prod(shape)))
            cost, *rows = (a[places].reshape((*shape, *a.shape[1:])) for a in found[:4])
            return Derivative(cost, state.points(rows[0]), state.points(rows[1]), control.points(rows[2]))

        leaves, structure = jax.tree.flatten(parameters)
        begins = 2 * n + 1 + np.cumsum([0, *(np.size(leaf) for leaf in leaves)])
        own = [part(int(k), np.shape(leaf)) for k, leaf in zip(begins, leaves, strict=False)]
        by_parameters = jax.tree.unflatten(structure, own) if leaves else None
        return cls(part(0, (n,)), part(n, (n,)), part(2 * n, ()), by_parameters)


def require_isolated(found: Derivatives, solution: Solution) -> None:
    """Raise if the KKT system is singular to rounding, or a derivative is not finite."""
    if not found.smallest > CLEAR:
        raise ConvergenceError(
            "the system of optimality conditions is singular to rounding, its smallest pivot is "
            f"{found.smallest:.3g}: the extremal is one of a family, or its end is conjugate to its start, and it has "
            "no derivatives; try another horizon",
            solution,
        )
    lost = {_name_of(k, found, solution) for part in found[:4] for k in np.argwhere(~np.isfinite(part))[:, 0]}
    if lost:
        raise ConvergenceError(
            f"the problem's functions have no finite derivative by {' and '.join(sorted(lost))} along this extremal; "
            "try functions that are smooth there, as sqrt(x @ x + 1e-6) in place of a norm",
            solution,
        )


def _name_of(column: int, found: Derivatives, solution: Solution) -> str:
    """The name of the variable of the derivatives in a column."""
    first = len(found.cost) - sum(np.size(leaf) for leaf in jax.tree.leaves(solution.parameters))
    if column >= first - 1:
        return "its parameters" if column >= first else "its horizon"
    return "its start" if column < (first - 1) // 2 else "its end"
