"""One reader for every record that the library writes."""

from pathlib import Path
from typing import Any

from .integrators import load_closed_loop, load_solution, load_solutions, load_trajectory
from .integrators.reporting.records import record_kind
from .manifolds import InvalidInputError

READERS = {
    "Solution": load_solution,
    "Solutions": load_solutions,
    "Trajectory": load_trajectory,
    "ClosedLoop": load_closed_loop,
}


def load(path: str | Path) -> Any:
    """Load a ``Solution``, a batch of solutions, a ``Trajectory``, a ``ClosedLoop``, or a sweep.

    Parameters
    ----------
    path : str or Path
        The file that ``save`` wrote, or the folder of a sweep. Nothing in it is executed.

    Returns
    -------
    Solution, Solutions, Trajectory, ClosedLoop or Sweep
        The record that was saved, with its numbers to the last bit.

    Raises
    ------
    InvalidInputError
        If the file is damaged, incomplete, of another version, or something else.

    Notes
    -----
    ``load_solution(path, retraction, controls)`` reads a solution whose retraction is a custom class.

    Examples
    --------
    >>> line = Euclidean(1)
    >>> moved = OptimalControlProblem(line, lambda q, u: u, lambda q, u: u @ u / 2, controls=1)
    >>> found = solve(moved, 0.0, 1.0, 2.0, method=Midpoint(Addition(line)), steps=4)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     found.save(f"{folder}/moved.npz")
    ...     load(f"{folder}/moved.npz").cost == found.cost
    True
    """
    place = Path(path)
    if place.is_dir():
        from .sweeps import load_sweep

        return load_sweep(place)
    kind = record_kind(place)
    if kind not in READERS:
        raise InvalidInputError(
            f"{path} is not a record of retrax: it has {f'the schema {kind:.60}' if kind else 'no entry schema'}; "
            f"expected a file from the method save of {', '.join(READERS)}"
        )
    return READERS[kind](place)
