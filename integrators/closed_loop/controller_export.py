"""The method ``export_c`` of a controller: a receding horizon controller as a folder of C source."""

from copy import copy
from pathlib import Path
from typing import Any

import numpy as np

from ...manifolds import Euclidean, InvalidInputError
from ..boundary_value.export.c_export import origin_of, pose, require_name, require_new, write_folder
from ..boundary_value.inputs.options import Options
from ..problem.path_constraints import count
from ..problem.point_layout import PointLayout

TEST_SAMPLES = 4  # of the controller in Python that the test of the program compares with
FIRST_ITERATIONS = 100  # of the first solve, as of Solver.solve


def export_c(self: Any, folder: str | Path, name: str, start: Any, time: float = 0.0) -> Path:
    """A folder of C source with this controller, for a computer without Python, such as a flight computer.

    Parameters
    ----------
    folder : str or Path
        The folder, which is new or empty.
    name : str
        The name of the library, and the prefix of its functions and types: an identifier of C.
    start : point
        A state from which the first solve has success. The first solve in C starts from the same guess.
    time : float
        The time of this state. Functions ``end`` and ``parameters`` of this controller give the first values in C.

    Returns
    -------
    Path
        The folder. Build it with ``cmake -B build && cmake --build build && ctest --test-dir build``.

    Raises
    ------
    InvalidInputError
        For a controller with ``delay`` or ``milliseconds``, with node constraints, free parameters, or controls with
        bounds that are not in R^m; and as in ``Solver.export_c``.
    ConvergenceError
        If there is no solution from the start.

    Notes
    -----
    ``name_step(controller, state, time, control, workspace)`` in ``name_controller.h`` returns the control of one
    sample, with the same shift, warm start, budget of iterations, and fallback to an earlier plan as this controller.
    After a failure, this controller tries the feedback law and other guesses too. The C program does not. The folder
    has the bare solver too, as ``Solver.export_c`` writes it.
    """
    from ..boundary_value.export.controller_source import controller_files
    from ..boundary_value.export.problem_source import files

    where = require_new(Path(folder))
    require_name(name)
    _require_exportable(self)
    begun, budget = copy(self), self._budget[0]
    begun._begin()
    control = begun(start, time)
    found = origin_of(begun.solver, begun.plan)
    posed = pose(
        begun.solver, found, begun.plan, Options.of(self._tolerance, max(FIRST_ITERATIONS, budget or 0), None, False)
    )
    controller = _pose_controller(begun, found, time, control)
    return write_folder(where, files(posed, name, ("loop.c",)) | controller_files(posed, controller, name))


def _require_exportable(controller: Any) -> None:
    """Raise unless the program can do what a controller does."""
    problem = controller.problem
    wrong = {
        "a delay: predict the state, and pass the time at which the control acts": controller.delay,
        "a budget in milliseconds: measure a step on the processor, and pass max_iterations=": controller._budget[1],
        "node constraints: pass their functions as constraints": problem._limits.node_names,
        "bounds of controls outside of R^m": problem.control_bounds and not isinstance(problem.controls, Euclidean),
    }
    for words, given in wrong.items():
        if given:
            raise InvalidInputError(f"export_c does not treat a controller with {words}")


def _pose_controller(begun: Any, found: tuple[Any, Any, Any], time: float, control: Any) -> Any:
    """The controller of a first solve, with the controls of some more samples along its plan."""
    from ..boundary_value.export.controller_source import PosedController

    inner, own, formulation = found
    if formulation is not None and formulation.constants:
        raise InvalidInputError("export_c does not treat a controller with free parameters; try their values")
    if len(own.stage_times) < 2:
        raise InvalidInputError("export_c needs at least two points along a plan, got one; try more steps")
    traced, samples = inner._kept[own].transcribed.traced, _samples(begun, time, control)
    return PosedController(
        interpolant=own.interpolant,
        places=inner.stages,
        at_points=getattr(traced.steps, "state_at_point", None),
        groups=_groups(traced.rows),
        bounds=_bounds(begun.problem, samples[2].shape[1]),
        budget=begun._budget[0] or 0,
        acceptable=begun.acceptable,
        hold=begun.hold,
        horizon=begun.horizon,
        end_time=begun.end_time,
        samples=samples,
    )


def _samples(begun: Any, time: float, control: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times, flat states along the first plan, and controls there, all for the first end and parameters."""
    layout, acting, plan = PointLayout.of(begun.problem.manifold), PointLayout.of(begun.problem.controls), begun.plan
    step = begun.hold or plan.horizon / max(begun.solver.steps, TEST_SAMPLES + 1)
    times = time + step * np.arange(TEST_SAMPLES)
    times = times if begun.end_time is None else times[times < begun.end_time]
    rows = layout.rows(plan(np.minimum(plan.times[0] + times - time, plan.times[-1])).states, 1)
    given = begun._at(begun._parameters, time), begun._at(begun._end, time + plan.horizon)
    controls = [control, *(begun(layout.points(q), t, *given) for q, t in zip(rows[1:], times[1:], strict=True))]
    return times, rows, np.stack([acting.rows(u, 0) for u in controls])


def _groups(rows: Any) -> np.ndarray:
    """The ends of the columns of the inequalities of one name."""
    sizes = [len(side) for side in rows.limits.bounded.values() if side] + [count(size) for size in rows.sizes.values()]
    return np.cumsum([0, *sizes])


def _bounds(problem: Any, size: int) -> tuple[np.ndarray, np.ndarray]:
    """The bounds of the controls, infinite where there are none."""
    given = problem.control_bounds or (-np.inf, np.inf)
    shape = problem.controls.shape if isinstance(problem.controls, Euclidean) else (size,)
    low, high = (np.broadcast_to(np.asarray(side, float), shape).ravel() for side in given)
    return low, high
