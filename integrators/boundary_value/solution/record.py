"""The immutable record of a solved optimal control problem, and its file format."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, fields, is_dataclass
from functools import cached_property
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_type_hints

import numpy as np

from ....manifolds import ConvergenceError, Euclidean, InvalidInputError, Manifold
from ....manifolds.numerics.ambient import is_finite_number
from ....manifolds.numerics.tolerances import ACTIVE, SAME_TIME
from ....retractions import Retraction
from ...problem.quantities import Quantities
from ...reporting import presentation
from ...reporting.presentation import HistoryPlots
from ...reporting.records import RecordFile, Values, not_finite, shapes
from ..guess import Guess, Mesh, MeshGuess
from .diagnostics import RegularChecks
from .interpolation import Interpolant, Interpolation, Sample
from .names_elsewhere import attribute_hint
from .report import failure_text, report_text
from .solution_fields import SolutionFields, at_stages

FILE_VERSION = 7  # of the file
Status = Literal["minimum", "stationary", "failed"]
IN_TEXT = "interpolant", "quantities"  # fields of which a file holds a text


@dataclass(frozen=True, eq=False)
class Solution(SolutionFields, HistoryPlots, MeshGuess):
    r"""A discrete extremal with costates, multipliers and checks, in read-only NumPy arrays over nodes or stages.

    Attributes
    ----------
    times, t : array of shape (N + 1,)
        The times of the nodes.
    states, q : array, or tuple of arrays
        Points of the manifold at the nodes, shape ``(N + 1, *leaf)``.
    costates, p : array, or tuple of arrays
        Covectors at the nodes, ambient arrays of the shape of ``states``. Where a node constraint is active, the
        costate behind its jump; at the first node, the costate before it. At nodes with a cost, the costate behind it.
    stage_times : array of shape (N s,)
        The times of the stages.
    stage_states, stage_costates : array, or tuple of arrays
        States and costates at the stages, shape ``(N s, *leaf)``.
    controls, u : array, or tuple of arrays
        Controls at the stages, shape ``(N s, m)``.
    hamiltonians : array of shape (N s,)
        ``<p, X> - p_0 F`` at the stages.
    momenta, body_costates, spatial_costates : dict of str to array
        Of each factor with a group action the momentum; of each matrix group the costate in the body and in the spatial
        frame, shape ``(N + 1, d)``.
    cost : float
        The cost, in the unit of the running cost times time.
    success, result, message : bool, str, str
        Whether the first-order conditions hold, and a sentence on how the computation ended.
    status : {"minimum", "stationary", "failed"}
        ``"minimum"`` if the second-order conditions hold too.
    checks, statistics, singular : RegularChecks or SingularChecks, Statistics, SingularArc or None
        The figures of the solution, the effort, and the particulars of a singular extremal.
    multipliers : dict of str to array
        Nonnegative multipliers of the inequalities at the stages, shape ``(N s, k)``, per unit of time; multipliers of
        boundary constraints, shape ``(k,)``. Those of bounds of a horizon or of parameters belong to the first stage.
    node_multipliers : dict of str to array
        Nonnegative multipliers ``mu`` of the node constraints, shape ``(N + 1, k)``, by which the costate jumps: ``mu
        dg``.
    parameters : pytree or None
        The parameters, as given or found.
    interpolant, quantities : Interpolant, Quantities
        The polynomials between the nodes; the names and units of the problem.

    Notes
    -----
    :math:`\langle p, X \rangle - F - \nu g` is stationary in the controls, with :math:`\nu g = 0`. For boundary
    constraints, :math:`p(T) = -d(\Phi + \mu b)` in the last state and :math:`p(0) = d(\Phi_0 + \mu b)` in the first
    one; the cost changes by :math:`\mu e` if ``b = 0`` becomes ``b = -e``.

    Examples
    --------
    >>> line = Euclidean(1)
    >>> moved = OptimalControlProblem(line, lambda q, u: u, lambda q, u: u @ u / 2, controls=1)
    >>> found = solve(moved, 0.0, 1.0, 2.0, method=Midpoint(Addition(line)), steps=4)
    >>> found.success, found.status, round(found.cost, 6)
    (True, 'minimum', 0.25)
    >>> found.q.shape, found.u.shape, found.t[-1].item()
    ((5, 1), (4, 1), 2.0)
    """

    @property
    def status(self) -> Status:
        """The status: ``"minimum"``, ``"stationary"`` or ``"failed"``.

        A ``"minimum"`` is a strict local minimum of the discrete problem. A ``"stationary"`` solution satisfies the
        conditions of first order without a proof of a minimum. ``"failed"`` means no success.
        """
        return status_of(self.success, self.checks.strict_minimum)

    @property
    def horizon(self) -> float:
        """The time T from the first node to the last, as given or found."""
        return float(self.times[-1] - self.times[0])

    @property
    def steps(self) -> int:
        """Number of steps N."""
        return len(self.times) - 1

    @property
    def t(self) -> np.ndarray:
        """The times of the nodes, ``times``."""
        return self.times

    @property
    def q(self) -> np.ndarray | Any:
        """The states at the nodes, ``states``."""
        return self.states

    @property
    def p(self) -> np.ndarray | Any:
        """The costates at the nodes, ``costates``."""
        return self.costates

    @property
    def u(self) -> np.ndarray | Any:
        """The controls at the stages, ``controls``."""
        return self.controls

    @property
    def message(self) -> str:
        """A sentence on how the computation ended, ``result``."""
        return self.result

    def __call__(self, t: Any) -> Sample:
        """States, controls and costates at a time, from the polynomials of the method on the manifold.

        Parameters
        ----------
        t : float or array_like
            Times between the first node and the last.

        Raises
        ------
        InvalidInputError, DomainError
            For times outside the horizon, and for a step that does not fit into a chart.
        """
        return self._between_nodes(t)

    @cached_property
    def _between_nodes(self) -> Interpolation:
        if self.interpolant is None:
            raise InvalidInputError(
                "this solution was read from a file that says nothing of its retraction, which is not one of the "
                "library or is made with a function, and it has no polynomials between its nodes; try "
                "load_solution(path, retraction, controls)"
            )
        return self.interpolant.along(self)

    if not TYPE_CHECKING:  # a checker knows the attributes

        def __getattr__(self, name: str) -> Any:
            raise AttributeError(f"a Solution has no attribute {name!r}{attribute_hint(name, _ATTRIBUTES)}")

    def guess(self, after: float = 0.0, horizon: float | None = None) -> Guess:
        """This solution as a guess with the same steps and stages, or a part of it from a time on, for a warm start.

        Parameters
        ----------
        after : float
            The time since the beginning at which the guess starts; ``InvalidInputError`` if nothing is left.
        horizon : float, optional
            The duration of the guess, by default the rest. After the end of this solution the guess holds its last
            state, costate and control.
        """
        if not 0 <= after < self.horizon:
            raise InvalidInputError(
                f"a guess was asked for after {after:.6g} of a horizon of {self.horizon:.6g}, expected a time in it; "
                "try solution.guess(after=0.1 * solution.horizon)"
            )
        if not (horizon is None or (is_finite_number(horizon) and horizon > 0)):
            raise InvalidInputError(f"the horizon of a guess must be a positive finite time, got {horizon!r}")
        share = (self.horizon - after if horizon is None else horizon) / self.horizon
        if after > 0 or share != 1.0:
            begin = self.times[0] + after
            places = (begin + share * (times - self.times[0]) for times in (self.times, self.stage_times))
            return self._between_nodes.guess(*places)
        multipliers = self.stage_multipliers, self.node_multipliers
        return Guess(self.stage_states, self.controls, self.costates, self.states, self.stage_costates, *multipliers)

    def _guess_on(self, mesh: Mesh) -> Guess:
        """The solution at the nodes and stages of a mesh, over its own horizon.

        Raises ``InvalidInputError`` if it is of other manifolds, and ``DomainError`` where a step does not fit into one
        chart.
        """
        mesh.interpolant.require_fits("guess: ", self.states, self.controls)
        times, stage_times = (self.times[0] + places for places in mesh.times(self.horizon))
        if _are_same(times, self.times) and _are_same(stage_times, self.stage_times):
            return self.guess()
        # A file that says nothing of the retraction is read as one of this: what it is between the nodes is a guess all
        # the same.
        between = self._between_nodes if self.interpolant else mesh.interpolant.along(self)
        return between.guess(times, stage_times)

    def report(self) -> None:
        """A print of the figures of the solution: status, cost, violations, errors and time."""
        print(self)

    def __repr__(self) -> str:
        """The essential numbers, and the shapes of the rest."""
        span = f"times={self.times[0]:.6g}..{self.times[-1]:.6g}" if len(self.times) else "times=[]"
        arrays = [f"{name}={shapes(getattr(self, name))}" for name in ("states", "costates", "controls", "momenta")]
        kind = "" if self.singular is None else f"singular, on P_f of dimension {self.singular.dimension}; "
        checks = f"defect={self.checks.defect:.1e}, stationarity={self.checks.stationarity:.1e}"
        parts = [
            f"status={self.status!r}, cost={self.cost:.12g}, steps={self.steps}, {span}",
            *arrays,
            f"{kind}{checks}",
        ]
        return "\n  ".join(["Solution(", *parts, f"result={self.result!r})"])

    def __str__(self) -> str:
        return report_text(self)

    def _repr_html_(self) -> str:
        """The report, as a notebook shows it."""
        return f"<pre>{escape(str(self))}</pre>"

    def require_success(self) -> "Solution":
        """This solution; raises ``ConvergenceError`` with its result if the conditions are not met."""
        if not self.success:
            raise ConvergenceError(failure_text(self), self)
        return self

    @property
    def stage_multipliers(self) -> dict[str, np.ndarray]:
        """The multipliers of the inequalities, shape ``(N s, k)``, without boundary constraints."""
        return at_stages(self.multipliers)

    @property
    def jumps(self) -> np.ndarray:
        """At which nodes a constraint holds the trajectory, where the costate jumps, shape ``(N + 1,)``."""
        return self._active_places(self.node_multipliers, self.node_multipliers, len(self.times))

    def held_by(self, names: Collection[str]) -> np.ndarray:
        """The stages at which one of the named inequalities is active, there or at both nodes of the step, shape ``(N
        s,)``.

        Parameters
        ----------
        names : collection of str
            Names of inequalities.
        """
        stages = self._active_places(names, self.stage_multipliers, len(self.stage_times))
        nodes = self._active_places(names, self.node_multipliers, len(self.times))
        return stages | np.repeat(nodes[:-1] & nodes[1:], len(stages) // self.steps)

    def _active_places(self, names: Collection[str], multipliers: dict[str, np.ndarray], count: int) -> np.ndarray:
        """At which of so many places one of these inequalities holds the trajectory."""
        held = np.zeros(count, bool)
        for name, rows in multipliers.items():
            if name in names and isinstance(self.checks, RegularChecks) and self.checks.active.get(name, 0):
                held |= np.any(rows > ACTIVE * np.max(rows), axis=1)
        return held

    def to_xarray(self) -> Any:
        """The solution as an ``xarray.Dataset`` with named dimensions and units; see ``retrax.interop.to_xarray``."""
        return presentation.to_xarray(self)

    def to_pandas(self, at: Any = "nodes") -> Any:
        """The solution as a ``pandas.DataFrame`` with a column for each entry; see ``retrax.interop.to_pandas``.

        Parameters
        ----------
        at : {"nodes", "stages"} or array_like
            The rows: nodes, stages, or times.
        """
        return presentation.to_pandas(self, at)

    def to_html(
        self,
        path: str | Path,
        mesh: tuple[Any, Any] | None = None,
        title: str = "",
        degrees: bool = False,
        cones: Sequence[Any] = (),
        obstacles: Sequence[Any] = (),
    ) -> None:
        """A page in one file that shows the solution in motion; see ``retrax.plotting.to_html``.

        Parameters
        ----------
        path, mesh, title, degrees, cones, obstacles
            As in ``retrax.plotting.to_html``.
        """
        presentation.to_html(self, path, mesh, title, degrees=degrees, cones=cones, obstacles=obstacles)

    def save(self, path: str | Path) -> None:
        """An ``.npz`` file with the solution, which ``load_solution`` reads.

        Parameters
        ----------
        path : str or Path
            The file; ``InvalidInputError`` if the solution could not be read again.
        """
        values = {field.name: getattr(self, field.name) for field in fields(self) if field.name not in IN_TEXT}
        values["geometry"] = None if self.interpolant is None else self.interpolant.text
        values["quantities"] = None if self.quantities is None else self.quantities.text
        values["parameters"] = _in_tuples(self.parameters)
        values["multipliers"] = self.stage_multipliers
        values["boundary"] = {name: row for name, row in self.multipliers.items() if row.ndim == 1}
        _FILE.write(path, {name: _parts(value) if is_dataclass(value) else value for name, value in values.items()})


def status_of(success: bool, strict_minimum: bool) -> Status:
    """The status of an extremal with or without success."""
    return ("minimum" if strict_minimum else "stationary") if success else "failed"


def _are_same(one: np.ndarray, other: np.ndarray) -> bool:
    """Whether times are the same to rounding."""
    horizon = np.max(np.abs(other), initial=0.0)
    return one.shape == other.shape and bool(np.all(np.abs(one - other) <= SAME_TIME * horizon))


def _parts(value: Any) -> dict[str, Any]:
    """The fields of a dataclass by their names."""
    return {part.name: getattr(value, part.name) for part in fields(value)}


def _in_tuples(value: Any) -> Any:
    """Nested lists and tuples as tuples."""
    if isinstance(value, dict):
        return {key: _in_tuples(part) for key, part in value.items()}
    return tuple(map(_in_tuples, value)) if isinstance(value, tuple | list) else value


_SCHEMA = {name: hint for name, hint in get_type_hints(Solution, include_extras=True).items() if name not in IN_TEXT}
_ATTRIBUTES = sorted({*_SCHEMA, *(name for name in dir(Solution) if not name.startswith("_"))})
_FILE = RecordFile(
    "Solution",
    FILE_VERSION,
    {**_SCHEMA, "geometry": str | None, "quantities": str | None, "boundary": Annotated[Any, Values()]},
    lambda values: not_finite(values) if values["success"] else "",
)


def load_solution(path: str | Path, retraction: Retraction | None = None, controls: Manifold | None = None) -> Solution:
    """The solution in a file that ``Solution.save`` wrote; nothing in the file is executed.

    Parameters
    ----------
    path : str or Path
        The file.
    retraction : Retraction, optional
        The retraction of the method, if it is a custom class.
    controls : Manifold, optional
        The control manifold of the problem, if it is a custom class.

    Returns
    -------
    Solution
        The solution, with its numbers to the last bit.

    Raises
    ------
    InvalidInputError
        If the file is not a solution, or is damaged, incomplete or of another version; if the retraction acts on other
        points.
    """
    values = _FILE.read(path)
    text, names = values.pop("geometry"), values.pop("quantities")
    values["multipliers"] |= values.pop("boundary")
    own: Any = Euclidean(np.shape(values["controls"])[1:]) if isinstance(values["controls"], np.ndarray) else None
    try:
        quantities = None if names is None else Quantities.from_text(names)
        found = None if text is None or retraction is not None else Interpolant.from_text(text)
        for fitting in filter(None, (found, quantities)):
            fitting.require_fits("", values["states"], values["controls"])
    except InvalidInputError as error:
        raise InvalidInputError(
            f"{path} is not a saved solution: {error}; expected a file from Solution.save"
        ) from error
    if retraction is not None:
        found = Interpolant(retraction, controls or own)
        found.require_fits("", values["states"], values["controls"])
    return Solution(**values, interpolant=found, quantities=quantities)
