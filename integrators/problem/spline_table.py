"""Smooth tables: splines of SciPy that JAX differentiates."""

from collections.abc import Callable
from typing import Any, Literal, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ...manifolds import InvalidInputError
from ..reporting.text import brief
from .argument_errors import require_known_options

Outside = Literal["nan", "constant"]
OUTSIDE = "nan", "constant"
MONOTONE = "monotone"
CONDITIONS = "not-a-knot", "natural", "clamped"  # of SciPy's cubic splines, at the ends
GRID_ROUNDING = 1e-9  # of the length of a grid: points beyond the ends by less belong to the last pieces


@require_known_options
def tabulated(grid: Any, values: Any, kind: str = "not-a-knot", outside: Outside = "nan") -> "Table":
    """A smooth function through the values of a table, for dynamics, costs and constraints.

    Parameters
    ----------
    grid : array_like of shape (K,), or tuple of arrays
        The increasing points at which the values are known: times, altitudes. A tuple has a grid for each argument.
    values : array_like of shape (K, ...)
        A number or an array at each point; the first axes belong to the grids in order.
    kind : str
        ``"not-a-knot"``, ``"natural"`` or ``"clamped"``: a cubic spline with these conditions at its ends, and two
        continuous derivatives. ``"monotone"``: no overshoot, and one continuous derivative.
    outside : str
        The value outside of the grid: ``"nan"``, so that a solve does not use it, or ``"constant"``, the value at the
        nearest point of the grid.

    Returns
    -------
    Table
        A function of one number for each grid, or of arrays that are broadcast.

    Raises
    ------
    InvalidInputError
        For a grid of fewer than two points or that does not increase, and other values.

    Notes
    -----
    The coefficients are those of ``scipy.interpolate.CubicSpline`` and ``PchipInterpolator``, along one grid after the
    other. JAX differentiates the function any number of times; derivatives of third order jump at the points of the
    grid, and with ``"monotone"`` those of second order. With ``"constant"`` the first derivative jumps at the ends.

    Examples
    --------
    >>> wind = tabulated([0.0, 1.0, 2.0, 3.0], [0.0, 1.0, 8.0, 27.0])
    >>> float(wind(1.5).round(9)), float(jax.grad(wind)(1.5).round(9))
    (3.375, 6.75)
    """
    grids = [_grid(one) for one in (grid if isinstance(grid, tuple) else (grid,))]
    if kind not in (*CONDITIONS, MONOTONE):
        raise InvalidInputError(f"kind must be one of {', '.join((*CONDITIONS, MONOTONE))}, got {kind!r}")
    require_outside(outside)
    coefficients, shape = finite_array("the values of a table", values), tuple(map(len, grids))
    if coefficients.shape[: len(shape)] != shape:
        raise InvalidInputError(
            f"the values of a table have the shape {coefficients.shape}, expected {shape} and the axes of a value, for "
            f"grids of {' and '.join(map(str, shape))} points"
        )
    for place, points in enumerate(grids):
        coefficients = _pieces(points, coefficients, 2 * place, kind)
    return Table(tuple(grids), coefficients, outside)


@final
class Table:
    """A piecewise cubic function with a grid for each argument, as ``tabulated`` returns it.

    Attributes
    ----------
    grids : tuple of arrays
        The points of each argument.
    coefficients : array of shape (4, pieces of the last grid, ..., 4, pieces of the first grid, ...)
        The coefficients of the cubic polynomials, highest power first.
    outside : str
        The value outside of the grids, ``"nan"`` or ``"constant"``.

    Examples
    --------
    >>> tabulated([0.0, 1.0], [2.0, 4.0]).grids
    (array([0., 1.]),)
    """

    def __init__(self, grids: tuple[np.ndarray, ...], coefficients: np.ndarray, outside: Outside) -> None:
        self.grids, self.coefficients = grids, coefficients
        self.outside: Outside = outside

    def __call__(self, *points: Any) -> Array:
        """The value at a point.

        Parameters
        ----------
        *points : float or array
            A number for each grid. Arrays are broadcast, and their axes are the first of the result.

        Raises
        ------
        InvalidInputError
            For another number of arguments.
        """
        if len(points) != len(self.grids):
            raise InvalidInputError(
                f"a table of {len(self.grids)} grids has as many arguments, got {len(points)}; try table(x, y)"
            )
        given = jnp.broadcast_arrays(*(jnp.asarray(point, float) for point in points))
        if not given[0].ndim:
            return self._at(*given)
        found = jax.vmap(self._at)(*map(jnp.ravel, given))
        return found.reshape(*given[0].shape, *found.shape[1:])

    def __repr__(self) -> str:
        ranges = " x ".join(f"[{grid[0]:.6g}, {grid[-1]:.6g}]" for grid in self.grids)
        return f"Table(on {ranges}, {self.outside!r} outside)"

    def _at(self, *point: Array) -> Array:
        """The value at one point: the polynomials of the last argument first."""
        value = jnp.asarray(self.coefficients)
        for grid, x in reversed([*zip(self.grids, point, strict=True)]):
            piece, x = locate(grid, x, self.outside)
            cubic = jnp.tensordot(piece, value, (0, 1))
            along = x - piece @ grid[:-1]
            value = ((cubic[0] * along + cubic[1]) * along + cubic[2]) * along + cubic[3]
        return value


def locate(grid: np.ndarray, x: Array, outside: Outside) -> tuple[Array, Array]:
    """The piece of a grid that has a point, as the unit vector of its index, and the point inside the grid or NaN.

    A product with the unit vector takes the data of the piece: a tape needs one instruction per entry, as no index
    depends on the input.
    """
    is_behind = (x >= grid[1:-1]).astype(float)
    piece = jnp.concatenate([jnp.ones(1), is_behind]) - jnp.concatenate([is_behind, jnp.zeros(1)])
    if outside == "constant":
        return piece, jnp.clip(x, grid[0], grid[-1])
    slack = GRID_ROUNDING * (grid[-1] - grid[0])
    return piece, jnp.where((x >= grid[0] - slack) & (x <= grid[-1] + slack), x, jnp.nan)


def _pieces(grid: np.ndarray, values: np.ndarray, axis: int, kind: str) -> np.ndarray:
    """The coefficients of the pieces along an axis, highest power first, shape ``(4, K - 1, other axes)``."""
    from scipy.interpolate import CubicSpline, PchipInterpolator  # a third of a second

    make: Callable[..., Any] = PchipInterpolator if kind == MONOTONE else CubicSpline
    return make(grid, values, axis=axis, **({} if kind == MONOTONE else {"bc_type": kind})).c


def _grid(given: Any) -> np.ndarray:
    """The points of a grid; raises for other input."""
    grid = finite_array("a grid", given)
    if grid.ndim != 1 or len(grid) < 2 or not np.all(np.diff(grid) > 0):
        raise InvalidInputError(f"a grid must be at least two numbers that increase, got {brief(given)}")
    return grid


def finite_array(name: str, given: Any) -> np.ndarray:
    """Finite real numbers as an array; raises for other input."""
    try:
        found = np.array(given, float)
    except (TypeError, ValueError):
        found = np.array(np.nan)
    if not np.all(np.isfinite(found)):
        raise InvalidInputError(f"{name} must be finite real numbers, got {brief(given)}")
    return found


def require_outside(outside: Any) -> None:
    """Raise unless this is a value outside of a table."""
    if outside not in OUTSIDE:
        raise InvalidInputError(
            f'outside must be "nan", no value, or "constant", the value at the nearest end, got {outside!r}'
        )
