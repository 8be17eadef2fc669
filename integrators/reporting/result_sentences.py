"""The one table of results: each entry is a sentence that says what happened and what to try next."""

import inspect
import warnings
from functools import cache

import equinox as eqx
import numpy as np

from ...manifolds.numerics.precision import working_precision

BETTER = "a better guess (Guess.from_controls, Free(value) at a free end, or continuation)"


class Result(eqx.Enumeration):
    """The end of an integration, ``Trajectory.result``, to compare with ``Result.successful``; ``Result[item]`` is a
    sentence.

    Notes
    -----
    ``Solution.result`` is the sentence itself.

    Examples
    --------
    >>> Result[Result.successful]
    'The equations are solved to the tolerance asked for.'
    """

    successful = "The equations are solved to the tolerance asked for."
    stationary = (
        "The equations are solved to the tolerance asked for, and this is not shown to be a strict local minimum. A "
        "nearby trajectory may cost as much or less: the extremal is a saddle or contains conjugate points, such as "
        "opposite points of a sphere. Try another guess, such as Guess.from_waypoints along another path, and compare "
        "the costs."
    )
    rounded_end = (
        "The equations are solved, but rounding decides whether the controls reach the prescribed end, so neither the "
        "controls nor the cost are determined to the tolerance. Expected an end that the controls move by more than "
        "the rounding of its value; try to leave free the parts of the end that the controls hardly move (end=(..., "
        "None) in a product), or to replace the prescribed end with a terminal_cost."
    )
    concave = (
        "The derivatives of the cost vanish, but the cost is concave in a control, so this is no minimum: it may be a "
        "maximum, and the cost may have no lower bound. Expected a cost that is convex in every control; try the other "
        "sign of a cost, a cost of this control, control_bounds, or another guess."
    )
    step_not_solved = (
        "The equations of a step could not be solved, and the trajectory stops there; try a smaller step size, or "
        "another retraction if the motion of one step leaves its domain."
    )
    jump = (
        "The Hamiltonian jumps where the trajectory passes, and no derivative tells of the jump: the momenta jump with "
        "it, and those of the trajectory do not; try jnp.tanh(x / a) with a small a instead of a step."
    )
    interrupted = "The computation was interrupted; the trajectory ends with the last state that was kept."
    stopped = "The iteration was stopped before the conditions were met; this is its best iterate."
    too_many_iterations = (
        "The iteration limit of a search came before the conditions were met; try more iterations, "
        f"{BETTER}, more steps, or a longer horizon: the end may be out of reach."
    )
    nearly_converged = (
        "The iteration limit came near an extremal, before its conditions were met to the tolerance; try more "
        "iterations, a larger tolerance, or another number of steps."
    )
    no_improvement = (
        "No step along the computed directions improves the trajectory any more, and the conditions are not met; try "
        f"{BETTER}, more steps, or a longer horizon."
    )
    singular = (
        "The system of optimality conditions stays singular: to first order the boundary conditions cannot be reached "
        "from this trajectory, or the cost does not determine the controls; check that the end point is reachable and "
        f"that the running cost is strictly convex in every control, or give more steps, or {BETTER}."
    )
    infeasible = (
        "The problem seems infeasible near the guess: the inequalities contradict each other or the ends at the points "
        "of these steps; this is the trajectory that violates them least; try more steps, wider bounds, a longer "
        f"horizon, free ends, or {BETTER}."
    )
    falling = (
        "The conditions are not met, and the cost fell as fast at the end as before: there may be no minimum; try "
        "bounds for controls and states, an upper bound of a free horizon, a cost that grows with them, or, if there "
        "is a minimum, more iterations or a better guess."
    )
    wrong_point = (
        "The equations have a solution here that does not end at the requested boundary point; try a "
        "guess that ends there."
    )
    no_extremal = (
        "The boundary conditions cannot all be met by an interior singular extremal near this trajectory: their "
        "residual is stationary and does not vanish. On P_f they contradict each other; free the components that are "
        "missed, where the optimum has an impulse or a bang arc, or give a guess if the problem has several extremals."
    )
    claim_broken = (
        "A trajectory was found that is no extremal: one of its conditions does not hold where it is evaluated; check "
        "that the functions of the problem are smooth in the controls, or try more steps."
    )
    not_finite = (
        "The problem's functions returned NaN or infinity at the guess or near it, where ends of steps may be; check "
        "them there, make them finite also where limits are violated, or give another guess."
    )


@cache
def sentence(name: str) -> str:
    """The entry of the table with this name."""
    return Result[getattr(Result, name)]


def reasons(result: str, *reasons: str) -> str:
    """The result with reasons, one of which says why no minimum is shown."""
    said = [reason.strip() for reason in reasons if reason]
    return " ".join([result.replace(sentence("stationary"), sentence("successful")), *said]) if said else result


def callers() -> int:
    """The level of the stack, as ``warnings.warn`` counts it for the caller of this, that called into this library."""
    frame, levels, level = inspect.currentframe(), list[int](), 0
    while frame is not None:
        if frame.f_globals.get("__name__", "").partition(".")[0] in ("retrax", "equinox"):
            levels.append(level)
        frame, level = frame.f_back, level + 1
    return levels[-1] + 1


@cache
def _warn_if_single(precision: np.dtype) -> None:
    if precision == np.float32:
        warnings.warn(
            "JAX is in single precision, so about six digits can be expected; for double precision run "
            'jax.config.update("jax_enable_x64", True) before the first array is made',
            stacklevel=callers(),
        )


@cache
def warn_of_coarse_values(name: str, given: str, expected: str) -> None:
    """Warn once if a user's function computes in a lower precision than everything else."""
    warnings.warn(
        f"{name} returns {given} values where {expected} is in use: it is known to few digits, and conditions may not "
        f"be met to the default tolerance; compute it in {expected}, or give a tolerance that it can meet",
        stacklevel=callers(),
    )


def warn_about_precision() -> None:
    """Warn once if JAX computes in single precision."""
    _warn_if_single(working_precision())
