"""The record of a discrete trajectory on ``T*Q``, and its file."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, final, get_type_hints

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ...manifolds import InvalidInputError
from ...manifolds.numerics.ambient import Ambient, is_traced
from ..problem.user_functions import require_concrete
from ..reporting.records import Along, RecordFile, not_finite, shapes
from ..reporting.result_sentences import Result
from ..reporting.text import brief

if TYPE_CHECKING:
    pass


@final
class Remark(str):
    """A text in a record that plays no part when records are compared or combined."""

    __slots__ = ()

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Remark)

    def __hash__(self) -> int:
        return hash(Remark)


@final
class Trajectory(eqx.Module):
    """A discrete trajectory on ``T*Q``, with the nodes along the leading axis of every array.

    Attributes
    ----------
    times : array of shape (N + 1,)
        The times of the nodes.
    q, p : array, or tuple of arrays
        Points and covectors at the nodes, shape ``(N + 1, *leaf)``.
    controls : array or None
        Stage controls of each saved step, at ``stage_times``; None for Hamilton's equations. A composition has one for
        each substep and a Gauss method one for each stage: shape ``(N, s, m)``.
    stage_times : array
        Times of the controls, shape ``(N,)`` or ``(N, s)``.
    result : Result
        The end of the integration: ``Result.successful``, ``step_not_solved``, ``jump`` or ``interrupted``.
    failed_step : int array
        The first step whose equations were not solved, else -1; the state is constant from there. With ``Result.jump``,
        a step in which the Hamiltonian jumps.
    evaluator : str
        The evaluator of the steps, and the reason if it is not the tape.
    """

    times: Annotated[Float[Array, " nodes"], Along("nodes", ndim=1)]
    q: Annotated[Ambient, Along("nodes")]
    p: Annotated[Ambient, Along("nodes", like="q")]
    controls: Annotated[Any, Along("stages", optional=True)]
    stage_times: Annotated[Float[Array, "steps ..."], Along("stages")]
    result: Result
    failed_step: Int[Array, ""]
    evaluator: Remark = eqx.field(static=True, default=Remark("not recorded"))

    def __repr__(self) -> str:
        """The essential numbers, and the shapes of the rest."""
        if is_traced(self) or np.ndim(self.times) != 1:
            parts = [f"{name}={shapes(getattr(self, name))}" for name in ("times", "q", "p", "controls", "failed_step")]
            return "\n  ".join(["Trajectory(", *parts]) + ")"
        span = (
            f"times={self.times[0]:.6g}..{self.times[-1]:.6g}, nodes={len(self.times)}, failed_step={self.failed_step}"
        )
        arrays = [f"{name}={shapes(getattr(self, name))}" for name in ("q", "p", "controls")]
        return "\n  ".join(["Trajectory(", span, *arrays, f"result={Result[self.result]!r})"])

    def save(self, path: str | Path) -> None:
        """An ``.npz`` file with the trajectory, which ``load_trajectory`` reads.

        Parameters
        ----------
        path : str or Path
            The file; ``InvalidInputError`` for a batch, under ``jit`` and ``vmap``, and if it could not be read again.
        """
        require_concrete("Trajectory.save", self)
        if np.ndim(self.times) != 1:
            raise InvalidInputError(
                f"a batch of trajectories cannot be saved, got times of shape {self.times.shape}; save each"
            )
        values: dict[str, Any] = {
            name: jax.device_get(getattr(self, name)) for name in _FILE.schema if name != "result"
        }
        ends = [name for name in _ENDS if self.result == getattr(Result, name)]
        _FILE.write(path, {**values, "result": ends[0], "failed_step": int(self.failed_step)})


_ENDS = ("successful", "step_not_solved", "jump", "interrupted")


def _disagreement(values: dict[str, Any]) -> str:
    """Words on a wrong result of a trajectory, or on wrong numbers, all of which are finite."""
    result, failed = values["result"], values["failed_step"]
    if result not in _ENDS:
        return f"the result is {brief(result)}, expected one of {', '.join(_ENDS)}"
    if failed < -1 or (failed >= 0) != (result in ("step_not_solved", "jump")):
        return f"the failed step is {failed} with the result {result}"
    return not_finite(values)


_FIELDS = {name: hint for name, hint in get_type_hints(Trajectory, include_extras=True).items() if name != "evaluator"}
_FILE = RecordFile("Trajectory", 1, {**_FIELDS, "result": str, "failed_step": int}, _disagreement)


def load_trajectory(path: str | Path) -> Trajectory:
    """The trajectory in a file that ``Trajectory.save`` wrote; nothing in the file is executed.

    Parameters
    ----------
    path : str or Path
        The file; ``InvalidInputError`` if it is something else, damaged, incomplete, or of another version.
    """
    values = _FILE.read(path)
    result, failed = getattr(Result, values.pop("result")), jnp.asarray(values.pop("failed_step"), int)
    return Trajectory(**jax.device_put(values), result=result, failed_step=failed)
