"""How a solve went: its convergence, and the sparsity of the problem that it solved."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ..manifolds import InvalidInputError
from ..manifolds.numerics.tolerances import EPS
from .axes import legend, one

if TYPE_CHECKING:
    from ..interop.discrete_problem import DiscreteProblem


def convergence(iterations: Sequence[Any], member: int = 0, ax: Any = None) -> Any:
    """Defect, stationarity and, with inequalities, violation and barrier parameter of each iteration of a solve.

    Parameters
    ----------
    iterations : sequence of Iteration
        The arguments of a ``callback``: ``solve(..., callback=iterations.append)``; ``InvalidInputError`` without one.
    member : int
        The number of a member of a batch.
    ax : matplotlib Axes, optional
        The axes; by default new axes. Zeros are drawn at the rounding of 1.

    Returns
    -------
    matplotlib Axes
        The axes.
    """
    kept = [(it.number, int(np.flatnonzero(it.members == member)[0]), it) for it in iterations if member in it.members]
    if not kept:
        raise InvalidInputError(
            f"there is no iteration of member {member} among {len(iterations)}; try iterations = [] and "
            "solve(..., callback=iterations.append)"
        )
    axis, numbers = one(ax), [number for number, _, _ in kept]
    for name in ("defect", "stationarity", "violation", "barrier"):
        values = np.array([getattr(it, name)[place] for _, place, it in kept])
        if name in ("defect", "stationarity") or np.any(values > 0):
            axis.semilogy(numbers, np.maximum(values, EPS), "o-", label=name, markersize=4)
    axis.set_xlabel("iteration")
    axis.set_ylabel("relative residual")
    axis.xaxis.get_major_locator().set_params(integer=True)
    legend(axis)
    return axis


def sparsity(discrete: "DiscreteProblem", ax: Any = None) -> Any:
    """The nonzero entries of the KKT matrix of a discrete problem: Hessian of the Lagrangian and Jacobian of the
    equations.

    Parameters
    ----------
    discrete : DiscreteProblem
        The result of ``retrax.interop.to_casadi``.
    ax : matplotlib Axes, optional
        The axes; by default new axes.

    Returns
    -------
    matplotlib Axes
        The axes: first the unknowns, then the equations.
    """
    import casadi as ca
    from scipy.sparse import bmat, coo_matrix

    nlp = discrete.nlp
    x, g = nlp["x"], nlp["g"]
    weights = ca.MX.sym("weights", g.shape[0])  # pyright: ignore[reportAttributeAccessIssue]  # made at run time
    hessian = ca.hessian(nlp["f"] + ca.dot(weights, g), x)[0].sparsity()
    jacobian = ca.jacobian(g, x).sparsity()

    def pattern(given: Any) -> Any:
        rows, columns = given.get_triplet()
        return coo_matrix((np.ones(len(rows)), (rows, columns)), shape=given.shape)

    matrix: Any = bmat([[pattern(hessian), pattern(jacobian).T], [pattern(jacobian), None]])
    axis = one(ax)
    size = x.shape[0] + g.shape[0]
    axis.spy(matrix, markersize=max(0.2, min(3.0, 300.0 / size)), color="C0")
    share = matrix.nnz / size**2
    axis.set_xlabel(f"{x.shape[0]} unknowns, {g.shape[0]} equations: {matrix.nnz} entries, {share:.2%} of the matrix")
    return axis
