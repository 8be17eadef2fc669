"""Newton's method for square systems, with implicit-function derivatives and a verdict on convergence."""

from collections.abc import Callable

import jax.numpy as jnp
import lineax as lx
import optimistix as optx
from jaxtyping import Array, Bool, Float

MAX_STEPS = 30


def tolerance(x: Array, power: float) -> float:
    """``eps^power`` for the precision of ``x``."""
    return float(jnp.finfo(x.dtype).eps ** power)


def solve_small(matrix: Float[Array, "m m"], right: Float[Array, " m"]) -> Float[Array, " m"]:
    """Solve a small dense system; a single equation is a division."""
    return right / matrix[0, 0] if matrix.shape[0] == 1 else jnp.linalg.solve(matrix, right)


def find_root(
    residual: Callable[[Float[Array, " k"]], Float[Array, " k"]], start: Float[Array, " k"]
) -> tuple[Float[Array, " k"], Bool[Array, ""]]:
    """Root of ``residual`` near ``start`` and whether Newton's method converged to it.

    Both sides have shape ``(k,)`` and unknowns of order one: the iteration ends when its step is below ``eps^0.65``
    (7e-11 in double precision), after which quadratic convergence leaves rounding only. Derivatives with respect to
    anything that ``residual`` closes over come from the implicit function theorem, in every autodiff mode.
    """
    step_size = tolerance(start, 0.65)
    solver = optx.Newton(rtol=step_size, atol=step_size, linear_solver=lx.LU())
    found = optx.root_find(lambda y, _: residual(y), solver, start, throw=False, max_steps=MAX_STEPS)
    return found.value, found.result == optx.RESULTS.successful
