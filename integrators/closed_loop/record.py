"""The record of a closed loop, and its file."""

from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Annotated, Any, final, get_type_hints

import numpy as np

from ...manifolds import InvalidInputError
from ..problem.quantities import Quantities
from ..reporting.presentation import HistoryPlots
from ..reporting.records import Along, RecordFile, not_finite, shapes, write_protect
from .statistics import ControllerStatistics

IN_TEXT = "solves", "quantities"  # fields of which a file holds a text


@final
@dataclass(frozen=True, eq=False)
class ClosedLoop(HistoryPlots):
    """A closed loop: the states of the plant, what the controller measured, its controls and its solves.

    Attributes
    ----------
    times, t : array of shape (N + 1,)
        The times of the samples, and the last time.
    states, q : array, or tuple of arrays
        The states of the plant at these times, shape ``(N + 1, *leaf)``.
    stage_times : array of shape (N,)
        The times from which the controls act.
    controls, u : array, or tuple of arrays
        The control of each sample, shape ``(N, m)``.
    measured : array, or tuple of arrays
        The state that the controller measured at each sample, shape ``(N, *leaf)``.
    is_held : bool
        Whether each control is constant until the next one acts.
    solves : ControllerStatistics or None
        The solves of a ``RecedingHorizon``.
    quantities : Quantities
        The names and units of the plant.
    """

    times: Annotated[np.ndarray, Along("nodes", ndim=1)]
    states: Annotated[np.ndarray | Any, Along("nodes")]
    stage_times: Annotated[np.ndarray, Along("stages", ndim=1)]
    controls: Annotated[np.ndarray | Any, Along("stages")]
    measured: Annotated[np.ndarray | Any, Along("stages")]
    is_held: bool
    solves: ControllerStatistics | None = None
    quantities: Quantities | Any = field(default=None, repr=False)

    def __post_init__(self) -> None:
        write_protect(vars(self))

    @property
    def t(self) -> np.ndarray:
        """The times of the samples, ``times``."""
        return self.times

    @property
    def q(self) -> np.ndarray | Any:
        """The states of the plant, ``states``."""
        return self.states

    @property
    def u(self) -> np.ndarray | Any:
        """The controls, ``controls``."""
        return self.controls

    def __repr__(self) -> str:
        """The essential numbers, and the shapes of the rest."""
        arrays = (f"{name}={shapes(getattr(self, name))}" for name in ("states", "controls", "measured"))
        span = f"times={self.times[0]:.6g}..{self.times[-1]:.6g}, samples={len(self.stage_times)}"
        return "\n  ".join(["ClosedLoop(", span, *arrays, f"solves={self.solves!r})"])

    def save(self, path: str | Path) -> None:
        """An ``.npz`` file with the closed loop, which ``load_closed_loop`` and ``load`` read.

        Parameters
        ----------
        path : str or Path
            The file; ``InvalidInputError`` if the record could not be read again.
        """
        values = {each.name: getattr(self, each.name) for each in fields(self)}
        texts = {name: None if values[name] is None else values[name].text for name in IN_TEXT}
        _FILE.write(path, values | texts)


_SCHEMA = get_type_hints(ClosedLoop, include_extras=True)
_FILE = RecordFile("ClosedLoop", 1, {**_SCHEMA, **dict.fromkeys(IN_TEXT, str | None)}, not_finite)


def load_closed_loop(path: str | Path) -> ClosedLoop:
    """The closed loop in a file that ``ClosedLoop.save`` wrote; nothing in the file is executed.

    Parameters
    ----------
    path : str or Path
        The file; ``InvalidInputError`` if it is something else, damaged, incomplete, or of another version.

    Returns
    -------
    ClosedLoop
        The record that was saved, with its numbers to the last bit.

    Examples
    --------
    >>> line = OptimalControlProblem(Euclidean(1), lambda q, u: u, lambda q, u: u @ u / 2, controls=1)
    >>> loop = simulate(line, lambda q, t: -q, np.ones(1), horizon=1.0, sample_time=0.5)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     loop.save(f"{folder}/loop.npz")
    ...     load_closed_loop(f"{folder}/loop.npz").times.tolist()
    [0.0, 0.5, 1.0]
    """
    values = _FILE.read(path)
    solves, names = (values.pop(name) for name in IN_TEXT)
    try:
        found = None if solves is None else ControllerStatistics.from_text(solves)
        quantities = None if names is None else Quantities.from_text(names)
        if quantities is not None:
            quantities.require_fits("", values["states"], values["controls"])
    except InvalidInputError as error:
        raise InvalidInputError(
            f"{path} is not a saved closed loop: {error}; expected a file from ClosedLoop.save"
        ) from error
    return ClosedLoop(**values, solves=found, quantities=quantities)
