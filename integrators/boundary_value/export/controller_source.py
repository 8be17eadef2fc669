"""A receding horizon controller as C source: the shift of trajectories on the manifold, beside the solver."""

from dataclasses import dataclass
from textwrap import indent
from typing import Any, final

import numpy as np

from ....manifolds import InvalidInputError
from ....tape.c_source import c_function, c_head
from ....tracing import one_tracing
from ..solution.interpolation import Interpolant
from ..transcription.chart import Polynomials
from .c_text import constant, fill_template, number
from .posed_problem import PosedProblem
from .problem_source import templates

CONTROL_TOLERANCES = 1e2  # tolerances by which controls may differ that are those of two solves
# Lines where a step has one point, whose state is the centre; and where there are inequalities.
ONE_WRITTEN = "    memcpy(to->centres, from->point_states, sizeof(to->centres));"
ONE_KEPT = "    memcpy(to->point_states, output->solution.centres, sizeof(to->point_states));"
LIMITS_WRITTEN = "    memcpy(to->multipliers, from->multipliers, sizeof(to->multipliers));"
LIMITS_KEPT = "    memcpy(to->multipliers, output->solution.multipliers, sizeof(output->solution.multipliers));"


@final
@dataclass(frozen=True, eq=False)
class PosedController:
    """The parts of a controller beside its solver.

    ``interpolant``, ``places``: of the method, with the places of its points in a step; ``at_points``: the function of
    the states at these; ``groups``: ends of the columns of inequalities of one name; ``bounds`` of the controls that
    are applied; ``samples``: times, states and controls of the controller in Python.
    """

    interpolant: Interpolant
    places: np.ndarray
    at_points: Any
    groups: np.ndarray
    bounds: tuple[np.ndarray, np.ndarray]
    budget: int
    acceptable: float
    hold: float | None
    horizon: float | None
    end_time: float | None
    samples: tuple[np.ndarray, np.ndarray, np.ndarray]


def controller_files(posed: PosedProblem, own: PosedController, name: str) -> dict[str, str]:
    """The texts of the files of a controller, by their names."""
    values = templates(posed, name)
    values |= _values(posed, own, values)
    return {
        f"{name}_controller.h": fill_template("controller.h", values),
        f"{name}_controller.c": fill_template("controller.c", values),
        "loop.c": fill_template("loop.c", values),
    }


def _values(posed: PosedProblem, own: PosedController, names: dict[str, str]) -> dict[str, str]:
    """The texts that fill the templates of a controller."""
    limited, several = len(posed.shares) > 0, len(own.places) > 1
    through, clock = _through(own), posed.transcription.sizes.state_numbers > posed.given_numbers
    inner = [f"of->point_states[k][{i}]" for i in np.flatnonzero(own.places < 1.0)] if several else []
    points = ["of->states[k]", *inner, "of->states[k + 1]"]
    centre = f"find_centre(of->point_states[k][{len(own.places) // 2}], of->states[k], of->states[k + 1], to->centre)"
    one = "memcpy(to->centre, of->point_states[k][0], sizeof(to->centre))"
    return {
        "own_controls": str(len(own.bounds[0])),
        "budget": str(own.budget),
        "held": "is that in the middle of the time for which it is held" if own.hold else "is that at this time",
        "functions": _functions_text(own),
        "control_size": str(posed.transcription.sizes.control_size),
        "through_count": str(len(through)),
        "constants": _constants_text(posed, own),
        "centre": fill_template("centre.c", names) if several else "",
        "points_of_step": ", ".join(points),
        "covectors_of_step": ", ".join(points).replace("states", "costates"),
        "write_centre": centre if several else one,
        "write_multipliers": fill_template("multipliers.c", names) if limited else "",
        "shift_multipliers": "    shift_multipliers(of, after, share, to);" if limited else "",
        "clock": indent(fill_template("clock.c", names), "    ") if clock else "",
        "write_points": indent(fill_template("collocation_guess.c", {}), "    ") if several else ONE_WRITTEN,
        "write_limits": LIMITS_WRITTEN if limited else "",
        "keep_points": indent(fill_template("collocation_points.c", {}), "    ") if several else ONE_KEPT,
        "keep_limits": LIMITS_KEPT if limited else "",
        "plan_horizon": _horizon_text(own),
        "start_time": f"    input->parameters[{names['NAME']}_PARAMETERS - 1] = time;\n" if clock else "",
        **_samples_text(posed, own),
    }


def _through(own: PosedController) -> np.ndarray:
    """The places in a step that its polynomial goes through."""
    return np.concatenate([[0.0], own.places[own.places < 1.0] if len(own.places) > 1 else [], [1.0]])


def _functions_text(own: PosedController) -> str:
    """The functions of the interpolation."""
    with one_tracing():
        found = dict(own.interpolant.functions)
    if own.at_points is None:
        del found["chart_uneven"]  # of the centres of collocation
    else:
        found["state_at_point"] = own.at_points
    tapes: dict[str, Any] = {name: getattr(function, "tape", None) for name, function in found.items()}
    if None in tapes.values():
        raise InvalidInputError(
            "export_c takes retractions whose inverses are tapes, to shift a trajectory; got "
            f"{own.interpolant.retraction}; try Solver(..., evaluator='tape'), or another retraction"
        )
    return "\n".join([c_head(), *(c_function(tape.program, name) for name, tape in tapes.items())])


def _constants_text(posed: PosedProblem, own: PosedController) -> str:
    through, several = _through(own), len(own.places) > 1
    slopes = Polynomials(through, np.zeros(0), np.eye(len(through))).slopes(own.places)
    low, high = own.bounds
    half = 0.0 if own.hold is None else own.hold / 2
    rows = [
        f"/* Half the time for which a control is held. */\nstatic const double half_hold = {number(half)};\n",
        "/* The largest defect and violation of an iterate that is applied, relative. */\n"
        f"static const double acceptable = {number(own.acceptable)};\n",
        constant("double", "step_fractions", posed.fractions, "Lengths of the steps, relative to the horizon."),
        constant("double", "point_places", own.places, "Places of the points in a step."),
        constant("double", "through", through, "Places that the polynomial of a step goes through."),
        constant("double", "lowest_control", low, "Bounds of the controls."),
        constant("double", "largest_control", high, "The same from above."),
    ]
    if several:
        rows.append(constant("double", "slopes", slopes, "Derivatives at the points of the polynomials there."))
        rows.append(constant("double", "tableau", posed.transcription.tableau[0], "Tableau of the method."))
    if len(posed.shares):
        count = len(posed.shares) // (posed.transcription.sizes.steps * len(own.places))
        rows.append(f"enum {{ LIMITS = {count}, GROUPS = {len(own.groups) - 1} }}; /* inequalities of a point */\n")
        rows.append(constant("int", "groups", own.groups, "Columns of the inequalities of one name."))
    return "\n".join(rows)


def _horizon_text(own: PosedController) -> str:
    """The duration of the plan that begins at ``time``."""
    if own.end_time is None:
        return number(own.horizon)
    return f"fmax({number(own.end_time)} - time, {number(own.horizon or 0.0)})"


def _samples_text(posed: PosedProblem, own: PosedController) -> dict[str, str]:
    """The samples of the controller in Python."""
    times, states, controls = own.samples
    return {
        "close": number(CONTROL_TOLERANCES * posed.tolerance),
        "sample_count": str(len(times)),
        "samples": "\n".join(
            [
                constant("double", "sample_times", times, "Times of the samples."),
                constant("double", "sample_states", states, "Measured states."),
                constant("double", "sample_controls", controls, "Controls of the controller in Python."),
            ]
        ),
    }
