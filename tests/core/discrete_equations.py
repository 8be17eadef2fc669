"""The discrete equations of a trajectory as the mathematics writes them, with derivatives by JAX."""

from functools import cached_property
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from retrax.integrators.boundary_value.transcription.discrete_phase import DiscretePhase
from retrax.integrators.problem.point_layout import PointLayout
from retrax.manifolds.numerics import ambient as vec
from retrax.retractions import default_retraction


class DiscreteEquations:
    """The Lagrangian of each step of a trajectory as a function of steps of its unknowns.

    A step of a discretization map has the unknowns ``(x, u)``: it is ``(A_x(-theta h X), B_x((1 - theta) h X))`` with
    the dynamics ``X(x, u)``, and costs ``h F(x, u)``. A step of collocation has ``(x, nu_1 ... nu_s, u_1 ... u_s)``:
    points ``q_i = R_x(xi_i)``, ``xi_i = h sum_j (a_ij - b_j / 2) nu_j``, whose velocities have to be the dynamics, and
    ends ``R_x(-eta / 2)``, ``R_x(eta / 2)``, ``eta = h sum_j b_j nu_j``. Vectors are carried with ``x`` by projection.
    """

    def __init__(self, phase: DiscretePhase) -> None:
        self.phase, steps = phase, phase.transcription
        self.problem, self.method, self.collocates = steps.problem, steps.method, steps.stages > 1
        self.manifold, self.controls = self.problem.manifold, self.problem.controls
        self.state, self.control = PointLayout.of(self.manifold), PointLayout.of(self.controls)
        self.count, self.s = phase.data.steps.shape[1], steps.stages
        self.n, self.m = self.manifold.dimension, self.controls.dimension
        self.inner = self.s * self.n if self.collocates else 0
        self.size = self.n + self.inner + self.s * self.m
        self.bound = self.problem.with_parameters(steps.parameter.point(phase.data.parameters[0]))
        self._at_all = jax.jit(jax.vmap(self._derivatives))
        self._moved_all = jax.jit(jax.vmap(self._moved_of))

    def control_at(self, u: Any, d: Any) -> Any:
        turn, control = default_retraction(self.controls), self.control.point(u)
        return turn(control, vec.combine(self.controls.basis(control), d))

    def unknowns(self, given: dict[str, Any], d: Any) -> tuple[Any, Any, Any]:
        """The centre, the vectors of the velocities there, and the controls, after a step."""
        x = self.state.point(given["x"])
        frame = self.manifold.basis(x)
        retraction = self.method.retraction
        centre = retraction(x, vec.combine(frame, d[: self.n]))
        change = d[self.n : self.n + self.inner].reshape(-1, self.n)
        coordinates = given["nu"] + change if self.collocates else change
        nu = [self.manifold.projection(centre, vec.combine(frame, own)) for own in coordinates]
        turns = d[self.n + self.inner :].reshape(self.s, self.m)
        return centre, nu, [self.control_at(u, own) for u, own in zip(given["u"], turns, strict=True)]

    def values(self, given: dict[str, Any], d: Any) -> dict[str, Any]:
        """Ends, defects of points, cost and inequalities of a step."""
        centre, nu, controls = self.unknowns(given, d)
        h, bound = given["h"], self.bound
        if self.collocates:
            begin, finish, points, defects = self._collocated(given, centre, nu, controls)
            weights = h * self.method.weights
        else:
            points, defects, weights = [centre], jnp.zeros(0), [h]
            begin, finish = self._mapped(centre, vec.scale(h, bound.velocity(centre, controls[0])))
        at = list(zip(points, controls, strict=True))
        cost = sum(w * bound.cost_rate(q, u) for w, (q, u) in zip(weights, at, strict=True))
        limits = [bound.inequalities(q, u) for q, u in at]
        ends = [bound.node_inequalities(end) for end in (finish, begin)]
        return {
            "begin": self.state.flat(begin), "finish": self.state.flat(finish), "defects": defects, "cost": cost,
            "limits": jnp.concatenate([*limits, *ends]),
        }  # fmt: skip

    def _mapped(self, x: Any, v: Any) -> tuple[Any, Any]:
        theta = self.method.theta
        return self.method.backward(x, vec.scale(-theta, v)), self.method.forward(x, vec.scale(1 - theta, v))

    def _collocated(self, given: dict[str, Any], centre: Any, nu: Any, controls: Any) -> tuple[Any, ...]:
        h, retraction, base = given["h"], self.method.retraction, self.state.point(given["x"])
        points, defects, frame = [], [], self.manifold.basis(base)

        def mean(weights: Any, vectors: Any) -> Any:
            return vec.scale(h, sum_of([vec.scale(w, v) for w, v in zip(weights, vectors, strict=True)]))

        for i in range(self.s):
            xi = mean(self.method.centred[i], nu)
            q, velocity = jax.jvp(lambda a: retraction(centre, a), (xi,), (nu[i],))
            here = h * (self.method.centred[i] @ given["nu"])  # the frame is that of the iterate
            e = self.manifold.basis(retraction(base, vec.combine(frame, here)))
            lacking = vec.subtract(velocity, self.bound.velocity(q, controls[i]))
            points.append(q)
            defects.append(h * self.method.weights[i] * vec.components(e, lacking))
        half = vec.scale(0.5, mean(self.method.weights, nu))
        return retraction(centre, vec.scale(-1.0, half)), retraction(centre, half), points, jnp.concatenate(defects)

    def lagrangian(self, given: dict[str, Any], d: Any) -> Any:
        """The cost of a step and of the ends beside it, with all multipliers times their equations."""
        own = self.values(given, d)
        total = own["cost"] + given["lambda"] @ own["defects"] + (given["weights"] * given["nu_limits"]) @ own["limits"]
        total += given["before"] @ own["begin"] - given["after"] @ own["finish"]
        return total + self.end_cost(given, own)

    def end_cost(self, given: dict[str, Any], own: dict[str, Any]) -> Any:
        first, last = self.bound.first_cost, self.bound.final_cost
        total = given["is_first"] * first(self.state.point(own["begin"]))
        return total + given["is_last"] * last(self.state.point(own["finish"]))

    def _derivatives(self, given: dict[str, Any]) -> dict[str, Any]:
        zero = jnp.zeros(self.size)
        return {
            **self.values(given, zero),
            **{f"{k} by": v for k, v in jax.jacfwd(lambda d: self.values(given, d))(zero).items()},
            "hessian": jax.hessian(lambda d: self.lagrangian(given, d))(zero),
            "slope": jax.grad(lambda d: self.lagrangian(given, d))(zero),
            "gradient": jax.grad(
                lambda d: (lambda own: own["cost"] + self.end_cost(given, own))(self.values(given, d))
            )(zero),
            "frames": self._point_frames(given),
        }

    def _point_frames(self, given: dict[str, Any]) -> Any:
        """Frames at the points of a step of collocation, (s, n, E)."""
        if not self.collocates:
            return jnp.zeros(0)
        x, places = self.state.point(given["x"]), given["h"] * (self.method.centred @ given["nu"])
        frame = self.manifold.basis(x)
        at = [self.method.retraction(x, vec.combine(frame, own)) for own in places]
        return jnp.stack([self.state.flat_frame(self.manifold.basis(q)) for q in at])

    def _moved_of(self, given: dict[str, Any], d: Any) -> tuple[Any, Any, Any]:
        centre, nu, controls = self.unknowns(given, d)
        frame = self.manifold.basis(centre)
        turned = jnp.stack([vec.components(frame, own) for own in nu]) if self.collocates else jnp.zeros(0)
        return self.state.flat(centre), turned, jnp.stack([self.control.flat(u) for u in controls])

    @cached_property
    def frame_at(self) -> Any:
        """The frames at flat points, (..., n, E)."""
        return jax.jit(jax.vmap(lambda q: self.state.flat_frame(self.manifold.basis(self.state.point(q)))))

    def slope_of_cost(self, cost: Any, q: np.ndarray) -> np.ndarray:
        return np.asarray(jax.grad(lambda a: cost(self.state.point(a)) + 0.0 * a.sum())(jnp.asarray(q)))


def sum_of(vectors: list[Any]) -> Any:
    total = vectors[0]
    for own in vectors[1:]:
        total = vec.add(total, own)
    return total


class Expansion:
    """Everything of the linear system of an iterate, from the arrays of a trajectory of the core that are given."""

    def __init__(self, of: DiscreteEquations, at: Any) -> None:
        self.of, count, s, n = of, of.count, of.s, of.n
        self.x = at["CENTRES"].reshape(count, -1)
        self.u = at["CONTROLS"].reshape(count, s, -1)
        self.nu = at["VELOCITIES"].reshape(count, -1, n)
        self.h, self.fixed = at["STEP_SIZE"].copy(), at["FIXED"].reshape(count + 1, n)
        self.limits_of = (of.phase.transcription.own, of.phase.transcription.inequalities - of.phase.transcription.own)
        given = {
            "x": self.x, "u": self.u, "nu": self.nu, "h": self.h,
            "lambda": np.zeros((count, of.inner)), "weights": self.by_step(at["LIMIT_WEIGHTS"]),
            "nu_limits": self.by_step(at["LIMIT_MULTIPLIERS"]),
            "before": np.zeros_like(self.x), "after": np.zeros_like(self.x),
            "is_first": np.eye(count)[0], "is_last": np.eye(count)[-1],
        }  # fmt: skip
        first = of._at_all(given)
        begins, finishes = (np.asarray(first[name]) for name in ("begin", "finish"))
        self.nodes = np.concatenate([begins[:1], finishes])
        self.nodes[0] = np.where(at["START_ENTRIES"], at["START"], self.nodes[0])
        self.nodes[-1] = np.where(at["END_ENTRIES"], at["END"], self.nodes[-1])
        self.frames = np.asarray(of.frame_at(self.nodes))
        gaps = np.concatenate([begins, self.nodes[-1:]]) - np.concatenate([self.nodes[:1], finishes])
        self.defects = self.fixed * np.einsum("kne,ke->kn", self.frames, gaps)
        paid = np.zeros_like(self.nodes)
        paid[0] = of.slope_of_cost(of.bound.first_cost, self.nodes[0])
        paid[-1] -= of.slope_of_cost(of.bound.final_cost, self.nodes[-1])
        costates = at["COSTATES"].reshape(count + 1, -1) - paid
        self.multipliers = self.fixed * np.einsum("kne,ke->kn", self.frames, costates)
        covectors = np.einsum("kne,kn->ke", self.frames, self.multipliers)
        self.paid, self.node_costates = paid, covectors + paid
        if of.collocates:
            self.point_frames = np.asarray(first["frames"])
            lambdas = at["POINT_COSTATES"].reshape(count, of.s, -1)
            given["lambda"] = np.einsum("ksne,kse->ksn", self.point_frames, lambdas).reshape(count, -1)
        given |= {"before": covectors[:-1], "after": covectors[1:]}
        self.given = given
        self.of_steps = {name: np.asarray(own) for name, own in of._at_all(given).items()}
        self.left = np.einsum("kne,kez->knz", self.frames[:-1], self.of_steps["begin by"])
        self.right = np.einsum("kne,kez->knz", self.frames[1:], self.of_steps["finish by"])

    def by_step(self, flat: np.ndarray) -> np.ndarray:
        """Inequalities step by step from the order of the core: of all points, then of all ends."""
        count, (own, at_ends) = self.of.count, self.limits_of
        if not self.of.collocates:
            return flat.reshape(count, own + at_ends).copy()
        points = count * self.of.s * own
        return np.concatenate([flat[:points].reshape(count, -1), flat[points:].reshape(count, at_ends)], axis=1)

    def flat(self, by_step: np.ndarray) -> np.ndarray:
        """The order of the core again."""
        if not self.of.collocates:
            return by_step.ravel()
        points = self.of.s * self.limits_of[0]
        return np.concatenate([by_step[:, :points].ravel(), by_step[:, points:].ravel()])

    def with_inequalities(self, at: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Hessian and slope with the share of the inequalities, and the slope that the barrier multiplies."""
        own, jacobian = self.of_steps, self.of_steps["limits by"]
        arrays = (self.by_step(at[k]) for k in ("SLACKS", "LIMIT_MULTIPLIERS", "EXCESSES", "PENALTIES"))
        s, nu, t, rho = arrays
        w = self.given["weights"]
        s, nu, zeta = (np.where(w > 0, own, 1.0) for own in (s, nu, rho - nu))
        stiff = w / (s / nu + t / zeta)
        hessian = own["hessian"] + np.einsum("kc,kci,kcj->kij", stiff, jacobian, jacobian)
        slope = own["slope"] + np.einsum("kc,kci->ki", stiff * own["limits"], jacobian)
        return hessian, slope, np.einsum("kc,kci->ki", stiff * (1 / nu - 1 / zeta), jacobian)

    def condensed(self, hessian: np.ndarray, slope: np.ndarray, driven: np.ndarray) -> dict[str, np.ndarray]:
        """The system in ``(dx, du)``: the velocities follow from the equations of the points."""
        of, own = self.of, self.of_steps
        if not of.collocates:
            found = {"HESSIANS": hessian, "LEFT": self.left, "RIGHT": self.right, "SLOPES": own["slope"]}
            return found | {"RIGHT_SIDES": slope, "BARRIER_SIDES": driven, "GRADIENTS": own["gradient"]}
        inner = np.arange(of.n, of.n + of.inner)
        outer = np.setdiff1d(np.arange(of.size), inner)
        jacobian = own["defects by"]
        z, y = np.zeros((of.count, of.size, len(outer))), np.zeros((of.count, of.size))
        z[:, outer] = np.eye(len(outer))
        z[:, inner] = -np.linalg.solve(jacobian[..., inner], jacobian[..., outer])
        y[:, inner] = -np.linalg.solve(jacobian[..., inner], own["defects"][..., None])[..., 0]
        self.maps, self.mending = z, y
        pulled = np.einsum("kyx,ky->kx", hessian, y) + slope
        down = lambda a: np.einsum("kyx,ky->kx", z, a)  # noqa: E731
        return {
            "HESSIANS": np.einsum("kyi,kyz,kzj->kij", z, hessian, z), "LEFT": self.left @ z, "RIGHT": self.right @ z,
            "SLOPES": down(own["slope"]), "RIGHT_SIDES": down(pulled), "BARRIER_SIDES": down(driven),
            "GRADIENTS": down(own["gradient"]), "POINT_DEFECTS": own["defects"],
            "POINT_MULTIPLIERS": self.given["lambda"], "POINT_FRAMES": self.point_frames,
            "BEFORE": np.einsum("kny,ky->kn", self.left, y), "AFTER": np.einsum("kny,ky->kn", self.right, y),
        }  # fmt: skip

    def kkt(self, hessian: np.ndarray, slope: np.ndarray) -> tuple[np.ndarray, np.ndarray, int]:
        """The dense matrix and right-hand side of Newton's step in all unknowns, nodes and points; the unknowns."""
        of, (count, size, n) = self.of, (self.of.count, self.of.size, self.of.n)
        unknowns, nodes = count * size, (count + 1) * n
        points = count * of.inner
        matrix = np.zeros((unknowns + nodes + points,) * 2)
        side = np.concatenate([slope.ravel(), self.defects.ravel(), self.of_steps["defects"].ravel()])
        rows = np.zeros((nodes + points, unknowns))
        for k in range(count):
            own = slice(k * size, (k + 1) * size)
            matrix[own, own] = hessian[k]
            rows[k * n : (k + 1) * n, own] += self.left[k]
            rows[(k + 1) * n : (k + 2) * n, own] -= self.right[k]
            rows[nodes + k * of.inner : nodes + (k + 1) * of.inner, own] = self.of_steps["defects by"][k]
        rows[:nodes] *= self.fixed.ravel()[:, None]
        matrix[unknowns:, :unknowns], matrix[:unknowns, unknowns:] = rows, rows.T
        free = np.arange(unknowns, unknowns + nodes)
        matrix[free, free] = self.fixed.ravel() - 1
        return matrix, -side, unknowns
