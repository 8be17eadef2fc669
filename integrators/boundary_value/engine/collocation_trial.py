"""The compiled pass on one trajectory of a Gauss method."""

import math
from collections.abc import Iterable
from typing import Any, final

import numpy as np

from ..transcription.iterate import CollocationUnknowns, Iterate
from .arrays import whole
from .collocation import Collocation, Inner
from .condensing import Ends, Points
from .fields import Fields, Shapes
from .inequalities import Held
from .kkt_system import Assembled, Step
from .transcription import Blocks, Nodes
from .trial import Called, Trial
from .trial_shapes import common_rows

# What its kernels work with, in the order in which ``collocation_kernels`` lays it out: of all steps, or where there is
# a dot of the trajectory; with an axis for one column where there is a bar, with both where there is a plus; the last
# two axes in one where there is a sign of equality; without the axis of one point where there is a colon, and without
# axes where there is a stroke.
OWN = (
    *("x/", "u/", "turns", "velocities", "xi", "eta", "covectors_at/", "frames_at", "multipliers_at"),
    *("hessian_at", "constraints", "columns_at", "defects"),
    *("hessian_of", "left_of", "right_of", "pulls"),
    *("factors", "swaps", "maps"),
    *("hessian", "left", "right", "columns", "before", "after"),
    *("slope_at", "gradient_at", "pull", "sloped=", "inner_gradient=", "whole", "gradient"),
    *("defect.", "multipliers_at.", "sloped.", "weights."),
    *("equations", "mapped", "images", "pivots", "total"),
    *("steps", "driven_at", "pull", "e", "right_side", "pulled", "dnu=", "dlambda="),
    *("lacks", "gap", "costs_at", "hessian_at.", "slope_at.", "columns_at."),
)
# Which arrays these are where there are no inequalities: slopes have one column, and nothing is added to them.
PLAIN = {
    "columns_at": "slope_at|", "columns_at.": "slope_at+", "defects": "defect|", "pulls": "pull|", "columns": "slopes|",
    "driven_at": "slope_at",
}  # fmt: skip
# And where there are some: they have a share in the condensed slopes, but not in those that tell what is stationary.
LIMITED = {"columns": "pushed:", "whole": "slopes"}


@final
class CollocationTrial(Trial):
    """That of a Gauss method, without inequalities at nodes."""

    def __init__(self, programs: list[Any], steps: Collocation, count: int) -> None:
        self.tableau = steps.tableau.matrix, steps.tableau.weights
        super().__init__(programs, steps, count)

    @staticmethod
    def functions(steps: Collocation, nodes: Nodes, count: int) -> Iterable[Called]:
        """The moved centres and controls, the ends of the steps, the frames at the nodes, points, both ends."""
        e, u, k, s = steps.state.size, steps.control.size, steps.parameter.size, steps.stages
        n, m, at = steps.directions, steps.controls.dimension, (1, count, s)
        around = [(1, count, e), (1, count, n)]
        yield steps._centre, 2, around
        yield steps._control, 3, [(*at, u), (*at, m)]
        yield steps._ends, 2, around
        yield nodes._in_frame, 2, [(1, count + 1, size) for size in (e, n, e, e)]
        yield steps._point, 3, [*((*at, size) for size in (e, n, n, u, e, 1)), (1, 1, 1, k), (*at, steps.own)]
        yield steps._both, 2, [*around, *[(1, count, e)] * 4]

    @staticmethod
    def shapes(steps: Collocation, count: int) -> Shapes:
        """Those of what the tapes write, of what is condensed, and of room to work in."""
        e, u, n, z, s = steps.state.size, steps.control.size, steps.directions, steps.dimension, steps.stages
        each, at, p, q = (1, count), (1, count + 1), s * n, 3 * n + steps.controls.dimension
        inner, c, columns = (*each, s), steps.inequalities, 2 if steps.inequalities else 1
        width = whole(z + columns)
        return {
            "x": (*each, e), "turns": (*each, n, n), "u": (*inner, u),
            "begins": (*each, e), "finishes": (*each, e),
            "frames": (*at, n, e), "gap": (*at, n), "coordinates": (*at, n), "costates": (*at, e),
            "hessian_at": (*inner, q, q), "slope_at": (*inner, q), "constraints": (*inner, n, q),
            "gradient_at": (*inner, q), "pushes": (*inner, c, q), "defect": (*inner, n), "costs_at": inner,
            "limits": (*inner, c), "frames_at": (*inner, n, e), "multipliers_at": (*inner, n),
            "hessian_of": (*each, 2 * n, 2 * n), "pull": (*each, 2 * n), "left_of": (*each, n, 2 * n),
            "right_of": (*each, n, 2 * n), "starts": (*each, n), "arrives": (*each, n),
            "velocities": (*inner, n), "covectors_at": (*inner, e), "xi": (*inner, n), "eta": (*each, n),
            "weights": inner, "factors": (*each, p, p), "swaps": (*each, p), "maps": (*each, p, width),
            "hessian": (*each, z, z), "left": (*each, n, z), "right": (*each, n, z), "slopes": (*each, z),
            "before": (*each, n, columns), "after": (*each, n, columns),
            "sloped": (*inner, n), "inner_gradient": (*inner, n), "whole": (*each, z), "gradient": (*each, z),
            "costs": each, "lacks": (*at, n), "dnu": (*inner, n), "dlambda": (*inner, n),
            "equations": (1, p, whole(p) + width), "mapped": (1, q, width), "images": (1, q, width),
            "pivots": (1, p), "total": (1, z, width), "e": (1, q), "right_side": (1, p), "pulled": (1, 2 * n),
        } | (_of_limits(each, (n, s, q)) if c else {})  # fmt: skip

    def rows(self, fields: Fields) -> tuple[np.ndarray, np.ndarray]:
        laid = dict[str, tuple[str, tuple[int, ...]]]()
        for name, (_, *shape) in fields.shapes.items():
            laid |= {name: (name, (*shape,)), f"{name}.": (name, (1, *shape)), f"{name}|": (name, (*shape, 1))}
            laid |= {f"{name}=": (name, (*shape[:-2], math.prod(shape[-2:]))), f"{name}/": (name, (math.prod(shape),))}
            laid |= {f"{name}+": (name, (1, *shape, 1)), f"{name}:": (name, (*shape[:1], *shape[2:]))}
        others = LIMITED if self.limited else PLAIN
        return common_rows(fields), fields.rows(laid[others.get(name, name)] for name in OWN)

    def addresses(self) -> tuple[int, ...]:
        from .collocation_kernels import addresses

        return addresses()

    def put(self, v: Any, iterate: Iterate, assembled: Assembled | None, step: Step | None) -> None:
        v["velocities"][...], v["covectors_at"][...] = iterate.unknowns.velocities, iterate.unknowns.costates
        if assembled is not None and step is not None:
            inner = assembled.blocks.inner
            v["frames_at"][...], v["multipliers_at"][...] = inner.frames, inner.multipliers
            v["dnu"][...], v["dlambda"][...] = step.inner

    def found(self, v: Any, held: Held | None) -> tuple[CollocationUnknowns, Blocks]:
        at = v["hessian_at"], v["constraints"], v["hessian_of"], v["left_of"], v["right_of"]
        columns, pushed = (v["slope_at"][..., None], v["defect"][..., None], v["pull"][..., None]), None
        if held is not None:
            columns, pushed = (v["columns_at"], v["defects"], v["pulls"]), v["pushed"][:, :, 0]
        points, ends = Points(*at[:2], *columns[:2]), Ends(*at[2:], columns[2])
        kept = v["factors"], v["swaps"].view(int), v["maps"]
        lacking = v["defect"], v["multipliers_at"], v["sloped"], v["points"]
        inner = Inner(
            v["before"][..., 0], v["after"][..., 0], *lacking, v["inner_gradient"], v["frames_at"], points, ends, kept
        )
        blocks = Blocks(
            v["hessian"], v["left"], v["right"], v["slopes"], v["gradient"], v["costs"], inner, held, pushed
        )
        return CollocationUnknowns(v["x"], v["velocities"], v["u"], v["covectors_at"]), blocks

    def inner(self, v: Any) -> Any:
        return v["dnu"], v["dlambda"]


def _of_limits(each: tuple[int, int], sizes: tuple[int, int, int]) -> Shapes:
    """The shapes of what inequalities at the points add: slopes in two columns, those at their barrier, and the steps
    of the unknowns of the points."""
    n, s, q = sizes
    inner = *each, s
    return {
        "columns_at": (*inner, q, 2), "defects": (*inner, n, 2), "pulls": (*each, 2 * n, 2), "driven_at": (*inner, q),
        "ways": (*inner, q),
    }  # fmt: skip
