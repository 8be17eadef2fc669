"""The shapes of the arrays of a compiled pass on one trajectory of so many steps, and where its kernels find them."""

import math
from typing import Any

import numpy as np

from .elimination import work_shapes
from .extent import OF_POINTS, Extent
from .fields import Fields, Shapes
from .inequalities import Surveyed
from .residuals import NUMBERS
from .scaling import unit_shapes
from .standing import STANDING

TOLD = "negative", "smallest", "bends", "size"  # of an elimination
# What all passes write, in the order in which ``trial_kernels`` lays it out, as all that is listed here; where there is
# a dot, with an axis for its one point, where there is a bar, for its one column, and where there is a stroke, without
# axes.
OUT = (
    *("begins", "finishes", "work", "covectors", "frames", "gap", "coordinates", "costates"),
    *("nodes", "gaps", "apart", "largest", "hessian", "left", "right", "slopes", "gradient"),
    *("hessian.", "slopes.", "limits", "pushes", "costs", "cost", *Extent._fields),
    *("along", "entries", "numbers", "surveyed", "points", "s", "nu", "t", "pushed", "zeros"),
    *("driven|", "lacks|", "steps|", "multipliers|", "finite", "grown", *TOLD, "change", "standing"),
    *("x/", "u/", "part", "dual", "turn_s", "turn_nu", "turn_t", "turned", "barrier", "ways"),
)


def written_shapes(steps: Any, count: int) -> Shapes:
    """The shapes of what all passes write."""
    e, n, z, c = steps.state.size, steps.manifold.dimension, steps.dimension, steps.inequalities
    each, at, points = (1, count), (1, count + 1), (1, count, steps.stages, c)
    return {
        "nodes": (*at, e), "gaps": (*at, e), "apart": at, "largest": (1, e), "work": (2, e),
        "covectors": ((count + 1) * e,), "cost": (1,), "pushed": (*each, 1, z, 2),
        "steps": (*each, z), "multipliers": (*at, n), "finite": (1, 1), "grown": (1, z),
        "change": (2,), "standing": (STANDING,), **dict.fromkeys(TOLD, (1,)),
        **dict.fromkeys(("s", "nu", "t", "turn_s", "turn_nu", "turn_t"), points),
        "part": (1,), "dual": (1,), "turned": (1, 4), "barrier": (1,), **({"driven": (*each, z)} if c else {}),
        "along": (1, n), "entries": (1, e), "highest": (1, e), "lowest": (1, e),
        "points": (1, OF_POINTS, n),
        # These come as zeros.
        "surveyed": (len(Surveyed._fields), 1), "numbers": (NUMBERS, 1),
        "support": (1, n, e), "sizes": (1, n), "missing": (1, n), "lacking": (1, n), "held": (1,),
        "parts": (1, z), "slope": (1, z), "curvature": (1, z),
    }  # fmt: skip


def setting_shapes(steps: Any, count: int, tableau: tuple[np.ndarray, np.ndarray]) -> Shapes:
    """The shapes of what stays the same."""
    e, n, (matrix, weights) = steps.state.size, steps.manifold.dimension, tableau
    return {
        "h": (count,), "parameters": (steps.parameter.size,), "matrix": matrix.shape, "weights": weights.shape,
        "fixed": ((count + 1) * n,), "start": (1, e), "end": (1, e), "start_entries": (e,), "end_entries": (e,),
        "columns": (e,), "arrays": (e,), "mean": (1,),
    }  # fmt: skip


def given_shapes(steps: Any, count: int) -> Shapes:
    """The shapes of what is given to a pass."""
    n, z, c = steps.manifold.dimension, steps.dimension, steps.inequalities
    each = (1, count, steps.stages, c)
    return {
        "nodes": (1, n), "unknowns": (1, z), "least": (1,), "wide_nodes": (1, n), "unit": (1,),
        "wide": (1, z), "inverse": (1, n), "cost": (1,), "raised": (1,), "scales": (1, z),
        "price": each, "bounds": (1, c), "rate": (1,), "room": (c,), "weighed": each,
    }  # fmt: skip


def room_shapes(steps: Any, count: int) -> Shapes:
    """The shapes of what an elimination works in, and units are found in."""
    n, z = steps.manifold.dimension, steps.dimension
    own = {"swaps": (n,), "own_sizes": (1, z), "own_values": (1, z), "ways": (1, z - n), "curved": (1,)}
    return work_shapes(count, n, z, 1) | unit_shapes(count, n, z) | own


def common_rows(fields: Fields) -> np.ndarray:
    """The rows of ``OUT``."""
    known = {name: (name, shape) for name, shape in fields.shapes.items()}
    for name, (first, shape) in tuple(known.items()):
        known |= {
            f"{name}.": (first, (*shape[:2], 1, *shape[2:])),
            f"{name}|": (first, (*shape, 1)),
            f"{name}/": (first, (math.prod(shape),)),
        }
    for name, first in (("driven", "slopes"), ("lacks", "gap")):
        for sign in ("", "|"):
            known.setdefault(f"{name}{sign}", known[f"{first}{sign}"])
    known["zeros"] = "surveyed", (fields.size - fields.begins["surveyed"],)
    _, count, z = fields.shapes["steps"]
    known.setdefault("ways", ("steps", (1, count, 1, z)))
    return fields.rows(known[name] for name in OUT)
