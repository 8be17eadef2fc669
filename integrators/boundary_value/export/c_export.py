"""The method ``export_c`` of a solver: a problem and its solver as a folder of C source."""

import re
import shutil
from pathlib import Path
from typing import Any

import jax
import numpy as np

from ...._version import __version__
from ....compute.binding.core_sources import core_sources
from ....manifolds import InvalidInputError
from ....manifolds.numerics.ambient import taken
from ...problem.point_layout import PointLayout
from ...problem_checks.requirements import require_treated
from ...reporting.text import brief
from ..inputs.arguments import ALONG
from ..inputs.options import Options
from ..solution.record import Solution
from ..transcription.core_transcription import arrays_of_member, flat_limits, make_transcription

AGREE = 1e-9  # relative: the costs of a search of the core and of the solution
UNTAPED = (
    "export_c takes functions that are tapes, and ends without conditions between them; got {}; try "
    "Solver(..., evaluator='tape'), which names the operation that has no tape"
)
BOUNDS = "bounds: of a free horizon T as 1 + log(T / horizon), then of free parameters"
NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
# Keywords of C, and names of the program.
TAKEN = re.compile(
    r"auto|break|case|char|const|continue|default|do|double|else|enum|extern|float|for|goto|if|inline|int|long|main|"
    r"register|restrict|return|short|signed|sizeof|static|struct|switch|typedef|union|unsigned|void|volatile|while|"
    r"core|example|retrax.*",
    re.IGNORECASE,
)


def export_c(
    self: Any, folder: str | Path, name: str, solution: Solution, tolerance: float | None = None,
    max_iterations: int = 100, gains: bool = False,
) -> Path:  # fmt: skip
    """A folder of C source that solves the problem on a computer without Python, such as a flight computer.

    Parameters
    ----------
    folder : str or Path
        The folder, which is new or empty.
    name : str
        The name of the library, and the prefix of its functions and types: an identifier of C.
    solution : Solution
        A successful solution that this solver found. It fixes which parts of the ends, of the horizon and of the
        parameters are free; their values are inputs of the C program.
    tolerance : float, optional
        The tolerance of the residuals in the C program; by default that of ``solve``.
    max_iterations : int
        The largest number of iterations in the C program.
    gains : bool
        Whether an output has the feedback gains of the controls at each step, from one elimination for each node.

    Returns
    -------
    Path
        The folder. Build it with ``cmake -B build && cmake --build build && ctest --test-dir build``.

    Raises
    ------
    InvalidInputError
        If the folder has files, the name is no identifier, or another solver found the solution; and for problems that
        cannot be exported: singular ones, conditions between the ends, and functions without a tape.

    Notes
    -----
    The folder holds C99 source, a ``CMakeLists.txt``, an example that compares with the solution in Python, and a test
    that runs the example. ``name_solve(input, output, workspace)`` allocates no memory. The size of the workspace is a
    constant. All numbers are in double precision. Phases are not exported. The C program does not
    make the checks of a solution that Python makes after a solve: read the status and the residuals of its output.
    """
    from .problem_source import files  # what compiles tapes is imported where it is needed

    where, options = require_new(Path(folder)), Options.of(tolerance, max_iterations, None, False)
    require_name(name)
    return write_folder(where, files(pose(self, origin_of(self, solution), solution, options, gains), name))


def require_new(folder: Path) -> Path:
    """The folder; raises if it has files."""
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InvalidInputError(f"folder = {folder} exists and is not an empty folder; try a new one, or remove it")
    return folder


def write_folder(where: Path, texts: dict[str, str]) -> Path:
    """Write files by their names, and the core; returns the folder."""
    core = where / "core"
    core.mkdir(parents=True)
    for file, text in texts.items():
        (where / file).write_text(text, encoding="utf-8")
    for source in core_sources():
        shutil.copyfile(source, (core if source.suffix else where) / source.name)
    return where


def require_name(name: Any) -> None:
    """Raise unless this is an identifier of C that the program does not use itself."""
    if not isinstance(name, str) or not NAME.fullmatch(name):
        raise InvalidInputError(
            f"name = {name!r}; expected an identifier of C, of letters, digits and underscores, such as 'slew'"
        )
    if TAKEN.fullmatch(name):
        raise InvalidInputError(f"name = {name!r} has another meaning in the C program; try another name, as 'slew'")


def origin_of(solver: Any, solution: Any) -> tuple[Any, Any, Any]:
    """The solver that has found a solution, its own solution, and the reformulation that it solves, or None."""
    require_treated(solver.problem, "export_c", *ALONG)
    formulation, solver, found = solver._reformulation.origin(solution) or (None, solver, solution)
    if not isinstance(solution, Solution) or found not in solver._kept or not solution.success:
        raise InvalidInputError(
            "export_c takes a successful solution of a regular problem that this solver found, got "
            f"{brief(solution)}; try solver.export_c(folder, name, solver.solve(...)) with one and the same solver"
        )
    return solver, found, formulation


def pose(solver: Any, found: tuple[Any, Any, Any], solution: Solution, options: Options, gains: bool = False) -> Any:
    """The problem of a solution.

    ``found``: the solver that has found the solution, its own solution, both others for a reformulation, and the
    reformulation, or None.
    """
    from .posed_problem import PosedProblem

    inner, own, formulation = found
    kept = inner._kept[own]
    place = np.array([kept.place])
    conditions = kept.transcribed.conditions.of(place)
    _require_exportable(kept.transcribed.traced)
    transcription = make_transcription(conditions, 0)
    guess = taken(kept.transcribed.guess, place)
    given = transcription.trajectory()
    given.take(arrays_of_member(conditions, guess, 0))
    if not _leads_to(transcription, given, solution.cost, options):
        given.set_iterate(kept.found.system(kept.place).iterate)
    steps, numbers = conditions.data.steps[0], PointLayout.of(solver.problem.manifold).size
    free = formulation if formulation is not None and formulation.kind.horizon else None
    shares, limit_steps = _shares(conditions)
    return PosedProblem(
        transcription=transcription,
        given=given,
        given_numbers=numbers,
        fractions=inner.fractions,
        horizon=_horizon(steps, inner.fractions),
        shares=shares,
        limit_steps=limit_steps,
        horizon_entry=None if free is None else numbers + free.constants - 1,
        at_guess=1.0 if free is None else free.at_guess,
        states=PointLayout.of(inner.problem.manifold).rows(own.states, 1),
        cost=float(solution.cost),
        duration=float(solution.times[-1] - solution.times[0]),
        tolerance=float(options.tolerance),
        max_iterations=options.max_iterations,
        gains=gains,
        columns=_columns(solver, kept, formulation),
        words=_words(inner, kept, formulation, solution),
    )


def _require_exportable(traced: Any) -> None:
    """Raise unless the ends are independent and the functions are tapes."""
    if traced.coupling is not None:
        raise InvalidInputError(UNTAPED.format("conditions between the ends"))
    if traced.evaluator.name != "tape":
        raise InvalidInputError(UNTAPED.format(f"functions on the evaluator {traced.evaluator.name!r}"))


def _leads_to(transcription: Any, given: Any, cost: float, options: Options) -> bool:
    """Whether a search from the guess converges to the cost of the solution, without another guess in between."""
    from ....compute.binding.search import Search, SearchStatus

    search = Search(transcription, options.tolerance, options.max_iterations)
    search.trajectory.copy_from(given)
    converged = search.run() is SearchStatus.CONVERGED
    found = search.read()
    near = abs(found.trajectory["TOTALS"][0] - cost) <= AGREE * max(abs(cost), 1.0)
    return converged and found.facts.converged and bool(near)


def _horizon(steps: np.ndarray, fractions: np.ndarray) -> float:
    """The horizon whose products with the fractions are the steps."""
    near = float(steps.sum() / fractions.sum())
    short = float(f"{near:.15g}")
    return short if np.array_equal(short * fractions, steps) else near


def _shares(conditions: Any) -> tuple[np.ndarray, np.ndarray]:
    """Weights of the inequalities relative to their steps, and the steps, in the order of the core."""
    method = conditions.transcription
    if not method.inequalities:
        return np.zeros(0), np.zeros(0, int)
    steps = conditions.data.steps
    weights = method.weights(conditions.data)[0]
    numbers = np.broadcast_to(np.arange(steps.shape[1])[:, None, None], weights.shape)
    relative = np.round(weights / steps[0][:, None, None], 15)
    return flat_limits(method, relative), flat_limits(method, numbers)


def _columns(solver: Any, kept: Any, formulation: Any) -> dict[str, list[str]]:
    """Names of the entries of a state, of a control, and of the inequalities of a point and of the ends of a step."""
    quantities, rows = solver.problem.quantities, kept.transcribed.traced.rows
    states = [name for quantity in quantities.states for name in quantity.columns]
    if formulation is not None:
        kind = formulation.kind
        states += [f"free parameter {k}" for k in range(kind.entries)]
        states += ["1 + log(horizon of the solution / horizon of the input)"] if kind.horizon else []
        states += ["time"] if solver.problem.time_dependent else []
    bound = rows.problem.with_parameters(kept.parameters)
    at_points = list(bound._inequality_names) if rows.limits.any else []
    at_nodes = [f"{name}[{k}]" if size else name for name, size in rows.node_sizes.items() for k in range(size or 1)]
    return {
        "states": states,
        "controls": [name for quantity in quantities.controls for name in quantity.columns],
        "multipliers of a point": at_points,
        "multipliers of a step, first at its end, then at its beginning": at_nodes,
    }


def _words(inner: Any, kept: Any, formulation: Any, solution: Solution) -> dict[str, str]:
    """Texts of the header."""
    paths = jax.tree_util.tree_flatten_with_path(solution.parameters)[0]
    free = () if formulation is None else formulation.kind.free
    leaves = [
        f"parameters{jax.tree_util.keystr(path)} of shape {np.shape(leaf)}"
        for place, (path, leaf) in enumerate(paths)
        if place not in free
    ]
    bounded = formulation is not None and (
        any(formulation.kind.horizon_bounds) or formulation.kind.below or formulation.kind.above
    )
    guessed = formulation is not None and formulation.kind.horizon
    timed = formulation is not None and formulation.own.time_dependent
    return {
        "version": __version__,
        "title": repr(inner),
        "parameters": "; ".join([*leaves, *([BOUNDS] if bounded else []), *(["start time"] if timed else [])]),
        "horizon": "guess of the free duration" if guessed else "duration, positive",
    }
