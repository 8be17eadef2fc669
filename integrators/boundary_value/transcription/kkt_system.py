"""The KKT matrix of an extremal, from the arrays that the compiled core assembles.

The barrier of an active inequality adds a stiffness to the Hessian that grows without bound: rounding hides the
curvature beside it. Here the multipliers of the inequalities, times their weights, are unknowns of the steps instead.
With the weighted stiffness :math:`D` the blocks are

.. math:: \\begin{bmatrix} H & J^T \\\\ J & -D^{-1} \\end{bmatrix},

with the Hessian :math:`H` of the Lagrangian and the derivatives :math:`J` of the inequalities.
"""

from functools import cached_property
from typing import final

import numpy as np

from ....compute.binding.block_elimination import BlockArrays, BlockResult, solve_blocks
from ....compute.binding.condensing import CollocationArrays, KeptArrays, condense_slope
from ....compute.binding.library import PLACE
from ....compute.binding.transcription import IterateNumbers, Scale, Transcription


@final
class KKTSystem:
    """The KKT matrix of one extremal, with N steps of z unknowns and r inequalities.

    Attributes
    ----------
    iterate, scale : IterateNumbers, Scale
        The extremal, and the scaling of its steps.
    hessian, left, right : arrays of shapes (N, z, z), (N, n, z), (N, n, z)
        The Hessians of the Lagrangian with the costs of the ends, and the derivatives of both ends of a step in the
        frames of the nodes.
    fixed : array of shape (2, n)
        1 for the coordinates of the first and of the last node that are prescribed, else 0.
    nodes, costates, frames, multipliers, defects : arrays of shapes (N + 1, E), (N + 1, E), (N + 1, n, E), (N + 1, n)
        States and covectors at the nodes, the frames there, and the multipliers and defects of the nodes in these.
    """

    def __init__(self, transcription: Transcription, iterate: IterateNumbers, scale: Scale) -> None:
        sizes = self.sizes = transcription.sizes
        self.iterate, self.scale, self._tableau = iterate, scale, transcription.tableau
        at = self._at = transcription.trajectory()
        at.set_iterate(iterate)
        at["LIMIT_WEIGHTS"] = np.zeros(len(at["LIMIT_WEIGHTS"]))  # without the share of the barrier
        at.evaluate()
        self.dimension = z = len(at["PARTS"])
        self.hessian = self.array("HESSIANS", sizes.steps, z, z)
        self.left, self.right = (self.array(name, sizes.steps, sizes.state_size, z) for name in ("LEFT", "RIGHT"))
        self.fixed = self.array("FIXED", sizes.steps + 1, sizes.state_size)[[0, -1]]
        self.nodes, self.costates = (
            self.array(name, sizes.steps + 1, sizes.state_numbers) for name in ("NODES", "NODE_COSTATES")
        )
        self.frames = self.array("NODE_FRAMES", sizes.steps + 1, sizes.state_size, sizes.state_numbers)
        self.multipliers, self.defects = (
            self.array(name, sizes.steps + 1, sizes.state_size) for name in ("MULTIPLIERS", "DEFECTS")
        )

    def array(self, name: str, *shape: int) -> np.ndarray:
        """An array of the trajectory; ``retrax_core.h`` explains the names."""
        return self._at[name].reshape(shape)

    def limits_of(self, flat: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Entries of all inequalities as rows of the points, ``(N, s, c)``, and of the ends of steps, ``(N, d)``."""
        sizes = self.sizes
        points = sizes.steps * sizes.points * sizes.inequalities
        shape = sizes.steps, sizes.points, sizes.inequalities
        return flat[:points].reshape(shape), flat[points:].reshape(sizes.steps, sizes.node_inequalities)

    def in_steps(self, flat: np.ndarray) -> np.ndarray:
        """Entries of all inequalities in rows of the steps, ``(N, r)``: of the points of a step, then of its ends."""
        return np.concatenate([part.reshape(self.sizes.steps, -1) for part in self.limits_of(flat)], axis=1)

    @cached_property
    def limit_jacobians(self) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of the inequalities by the unknowns of their point, and of the ends of their step."""
        sizes, flat = self.sizes, self._at["LIMIT_JACOBIANS"]
        n, (count, s, c, d) = sizes.state_size, (sizes.steps, sizes.points, sizes.inequalities, sizes.node_inequalities)
        width = n + sizes.control_size if s == 1 else 3 * n + sizes.control_size
        of_points = flat[: count * s * c * width].reshape(count, s, c, width)
        return of_points, flat[of_points.size :].reshape(count, d, 2 * n)

    @cached_property
    def collocation(self) -> CollocationArrays:
        """The equations of the collocation points, before their velocities are eliminated."""
        sizes = self.sizes
        n, count, s = sizes.state_size, sizes.steps, sizes.points
        q = 3 * n + sizes.control_size
        points = {"POINT_HESSIANS": (q, q), "POINT_JACOBIANS": (n, q), "POINT_SLOPES": (q, 1), "POINT_DEFECTS": (n, 1)}
        ends = {
            "END_HESSIANS": (2 * n, 2 * n),
            "END_LEFT": (n, 2 * n),
            "END_RIGHT": (n, 2 * n),
            "END_SLOPES": (2 * n, 1),
        }
        return CollocationArrays(
            self._at["STEP_SIZE"],
            *self._tableau,
            *(self.array(name, count, s, *shape) for name, shape in points.items()),
            *(self.array(name, count, *shape) for name, shape in ends.items()),
        )

    @cached_property
    def limits(self) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of the inequalities of a step, along the equations of its points.

        By the unknowns of the step, shape ``(N, r, z)``, and by velocities beside those that the unknowns determine,
        ``(N, r, s n)``.
        """
        sizes, (of_points, of_ends) = self.sizes, self.limit_jacobians
        count, s, p, c = sizes.steps, sizes.points, sizes.points * sizes.state_size, sizes.inequalities
        if s == 1:
            return of_points[:, 0], np.zeros((count, c, 0))
        maps = self.array("VELOCITY_MAPS", count, p, self.dimension + 1)
        kept = KeptArrays(self.array("FACTORS", count, p, p), self.array("SWAPS", count, p).view(PLACE), maps)
        rows = s * c + sizes.node_inequalities
        outer, inner = np.empty((count, rows, self.dimension)), np.empty((count, rows, p))
        for row in range(rows):
            slope, end_slope = np.zeros((count, s, of_points.shape[3])), np.zeros((count, of_ends.shape[2]))
            if row < s * c:
                slope[:, row // c] = of_points[:, row // c, row % c]
            else:
                end_slope[:] = of_ends[:, row - s * c]
            velocities, outer[:, row] = condense_slope(self.collocation, kept, slope, end_slope)
            inner[:, row] = velocities.reshape(count, p)
        return outer, inner

    def solve(self, slope: np.ndarray, defect: np.ndarray) -> BlockResult:
        """Solve for right-hand sides, shapes ``(N, z + r, k)`` and ``(N + 1, n, k)``.

        The steps of the inequalities' multipliers, times the weights, stand behind the unknowns of a step.
        """
        hessian, left, right, sizes = self.hessian, self.left, self.right, self.scale.unknowns
        if self.sizes.limits:
            hessian, nu_sizes = self._augment()
            none = np.zeros((*left.shape[:2], len(nu_sizes)))
            left, right = (np.concatenate([ends, none], axis=2) for ends in (left, right))
            sizes = np.concatenate([sizes, nu_sizes])
        blocks = hessian, left, right, slope, defect, *self.fixed, sizes, self.scale.nodes, np.ones(len(sizes))
        return solve_blocks(BlockArrays(*map(np.ascontiguousarray, blocks)), self.scale.cost)

    def _augment(self) -> tuple[np.ndarray, np.ndarray]:
        """The Hessians with the inequalities, ``(N, z + r, z + r)``, and the scaling of multipliers, ``(r,)``."""
        z, rows, cost = self.dimension, self.limits[0], self.scale.cost
        names = "LIMIT_WEIGHTS", "LIMIT_MULTIPLIERS", "SLACKS", "EXCESSES", "PENALTIES"
        weights, nu, slacks, excesses, penalties = (self.in_steps(self.iterate.array(name)) for name in names)
        with np.errstate(all="ignore"):
            elastic = np.where(np.isfinite(penalties), nu * excesses / (penalties - nu), 0.0)
            give = (slacks + elastic) / (weights * nu)
            asked = np.isfinite(give)
            rows = np.where(asked[..., None], rows, 0.0)
            reach = np.max(np.sum(np.abs(rows) * self.scale.unknowns, axis=2), axis=0)
            nu_sizes = np.where(reach > 0, cost / reach, cost)
        hessian = np.zeros((len(rows), z + len(nu_sizes), z + len(nu_sizes)))
        hessian[:, :z, :z], hessian[:, :z, z:], hessian[:, z:, :z] = self.hessian, rows.mT, rows
        hessian[:, z:, z:] = -np.where(asked, give, cost / nu_sizes**2)[..., None] * np.eye(len(nu_sizes))
        return hessian, nu_sizes
