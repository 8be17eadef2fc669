"""The compiled pass on one trajectory of a discretization map."""

from collections.abc import Iterable
from typing import Any, final

import numpy as np

from ..transcription.iterate import Iterate, Unknowns
from .fields import Fields, Shapes
from .inequalities import Held
from .kkt_system import Assembled, Step
from .transcription import Blocks, Nodes, OneStage
from .trial import Called, Trial
from .trial_shapes import common_rows


@final
class OneStageTrial(Trial):
    """That of a discretization map."""

    @staticmethod
    def functions(steps: OneStage, nodes: Nodes, count: int) -> Iterable[Called]:
        """The moved unknowns, the ends of the steps, the frames at the nodes, the blocks."""
        e, u, k = steps.state.size, steps.control.size, steps.parameter.size
        n, z, c = steps.manifold.dimension, steps.dimension, steps.inequalities
        given, ends = [(1, count, 1), (1, 1, k)], [(1, count, e)] * 4
        yield steps._move, 2, [(1, count, e), (1, count, u), (1, count, z), *given]
        yield steps._ends, 2, [(1, count, e), (1, count, u), *given]
        yield nodes._in_frame, 2, [(1, count + 1, size) for size in (e, n, e, e)]
        yield steps._row, 2, [(1, count, e), (1, count, u), *ends, *given, (1, count, c)]

    @staticmethod
    def shapes(steps: OneStage, count: int) -> Shapes:
        """Those of what the tapes write."""
        e, u, n, z = steps.state.size, steps.control.size, steps.manifold.dimension, steps.dimension
        c, each, at = steps.inequalities, (1, count), (1, count + 1)
        return {
            "x": (*each, e), "u": (*each, 1, u),
            "begins": (*each, e), "finishes": (*each, e),
            "frames": (*at, n, e), "gap": (*at, n), "coordinates": (*at, n), "costates": (*at, e),
            "hessian": (*each, z, z), "slopes": (*each, z), "left": (*each, n, z), "right": (*each, n, z),
            "gradient": (*each, z), "pushes": (*each, 1, c, z), "starts": (*each, n), "arrives": (*each, n),
            "costs": each, "limits": (*each, 1, c),
        }  # fmt: skip

    def rows(self, fields: Fields) -> tuple[np.ndarray, np.ndarray]:
        """Nothing is condensed."""
        return common_rows(fields), fields.rows([])

    def addresses(self) -> tuple[int, ...]:
        from .one_stage_kernels import addresses

        return addresses()

    def put(self, v: Any, iterate: Iterate, assembled: Assembled | None, step: Step | None) -> None:
        """There is nothing."""

    def found(self, v: Any, held: Held | None) -> tuple[Unknowns, Blocks]:
        pushed = None if held is None else v["pushed"][:, :, 0]
        blocks = v["hessian"], v["left"], v["right"], v["slopes"], v["gradient"], v["costs"]
        return Unknowns(v["x"], v["u"]), Blocks(*blocks, None, held, pushed)

    def inner(self, v: Any) -> None:
        """Nothing was condensed."""
