"""Functions of the core that only the core itself calls: parts of Newton's method, one by one."""

from ctypes import POINTER, Structure, byref, c_double, c_int, c_ssize_t, c_void_p
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from retrax.compute.binding.condensing import CollocationArrays, KeptArrays, _kept_struct, _sizes, _system, _workspace
from retrax.compute.binding.library import FLOAT, address_of, library
from retrax.compute.binding.structs import CollocationSystemStruct, CondensedSystemStruct, LayoutStruct
from retrax.compute.binding.transcription import Scale, Trajectory


class LimitScaleStruct(Structure):
    """``retrax_limit_scale``."""

    _fields_ = (
        ("rate", c_double),
        ("limits", c_void_p),
    )


class ResidualScaleStruct(Structure):
    """``retrax_residual_scale``."""

    _fields_ = (
        ("judging_nodes", c_void_p),
        ("judging_unknowns", c_void_p),
        ("least_part", c_double),
        ("nodes", c_void_p),
        ("cost", c_double),
    )


class LimitScale(NamedTuple):
    """Scaling factors of the inequalities; ``retrax_core.h`` explains them."""

    rate: float
    limits: np.ndarray  # (c,)


_LAYOUT, _LIMITS = POINTER(LayoutStruct), POINTER(LimitScaleStruct)
_SIGNATURES: dict[str, list[Any]] = {
    "retrax_lu_factorise": [c_ssize_t, c_void_p, c_void_p, c_void_p],
    "retrax_lu_solve": [c_ssize_t, c_void_p, c_void_p, c_ssize_t, c_void_p, c_int],
    "retrax_lu_solve_transposed": [c_ssize_t, c_void_p, c_void_p, c_void_p],
    "retrax_expand": [
        POINTER(CollocationSystemStruct), POINTER(CondensedSystemStruct), c_ssize_t, c_ssize_t, *[c_void_p] * 5
    ],
    "retrax_survey_inequalities": [_LAYOUT, c_void_p, _LIMITS],
    "retrax_step_inequalities": [_LAYOUT, c_void_p, c_double],
    "retrax_move_inequalities": [_LAYOUT, c_void_p, c_double, c_double, c_void_p],
    "retrax_measure_residuals": [_LAYOUT, c_void_p, POINTER(ResidualScaleStruct), _LIMITS],
    "retrax_expand_step": [_LAYOUT, c_void_p, c_void_p],
    "retrax_move_trajectory": [_LAYOUT, c_void_p, c_double, c_void_p],
}  # fmt: skip


@cache
def core() -> Any:
    """The library, with these functions too."""
    own = library()
    for name, arguments in _SIGNATURES.items():
        function = getattr(own, name)
        function.restype, function.argtypes = None, arguments
    return own


def measure(at: Trajectory, judging: Scale, steps: Scale, limits: LimitScale, least_part: float) -> None:
    """Measure how far a trajectory is from its conditions, and survey its inequalities.

    ``judging``, ``steps``: scaling factors that success is judged by, and those of steps; ``least_part``: the cost that
    sets the scale of slopes where their parts vanish, 0 where their curvature does.
    """
    vectors = [judging.nodes, judging.unknowns, steps.nodes]
    places = [address_of(own, FLOAT, own.shape, "scaling factors") for own in vectors]
    scale = ResidualScaleStruct(*places[:2], least_part, places[2], steps.cost)
    place = address_of(limits.limits, FLOAT, limits.limits.shape, "scaling factors of inequalities")
    of_limits = byref(LimitScaleStruct(limits.rate, place))
    here = byref(at._layout), at._address
    core().retrax_survey_inequalities(*here, of_limits)
    core().retrax_measure_residuals(*here, byref(scale), of_limits)


def step_inequalities(at: Trajectory, share: float) -> None:
    """Compute the steps of slacks, excesses and multipliers; a share of the way to the boundary may be made."""
    core().retrax_step_inequalities(byref(at._layout), at._address, share)


def move_inequalities(at: Trajectory, before: Trajectory, primal: float, dual: float) -> None:
    """Move slacks, excesses and multipliers from another trajectory by parts of their steps."""
    core().retrax_move_inequalities(byref(at._layout), before._address, primal, dual, at._address)


def expand(at: Trajectory) -> None:
    """Expand the step of the linear system to steps of the velocities and multipliers of points."""
    core().retrax_expand_step(byref(at._layout), at._address, at._of.workspace)


def move(at: Trajectory, before: Trajectory, part: float) -> None:
    """Move the unknowns from another trajectory by a part of the step from there."""
    core().retrax_move_trajectory(byref(at._layout), before._address, part, at._address)
    at._of.failure.check()


def expand_steps(
    arrays: CollocationArrays, kept: KeptArrays, step: np.ndarray, multipliers: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Velocities and multipliers of the points, shape (N, s, n, k), from the solution of a condensed system."""
    system, sizes = _system(arrays), _sizes(arrays)
    count, s, n, m, k = sizes
    velocities, lambdas, workspace = np.empty((count, s, n, k)), np.empty((count, s, n, k)), _workspace(sizes)
    core().retrax_expand(
        byref(system),
        byref(_kept_struct(kept, sizes)),
        0,
        count,
        address_of(step, FLOAT, (count, n + s * m, k), "step of a condensed system"),
        address_of(multipliers, FLOAT, (count + 1, n, k), "multipliers of a condensed system"),
        *(address_of(a, FLOAT, a.shape, "result") for a in (velocities, lambdas, workspace)),
    )
    return velocities, lambdas
