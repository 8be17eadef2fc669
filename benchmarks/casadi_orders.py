"""Peers of higher order: the rest-to-rest slew transcribed by RK4, Hermite-Simpson and Gauss-Legendre collocation, in
CasADi.

The states are the attitude and the body rate ``w``. Attitudes are unit quaternions ``q``, or modified Rodrigues
parameters ``s = n tan(angle / 4)`` of an axis ``n``, with the polynomial kinematics

    q' = q * (0, w) / 2,        s' = ((1 - |s|^2) w + 2 s x w + 2 (s . w) s) / 4.

Schemes, all with IPOPT, those marked * with FATROP too (their steps are explicit, with further equations):

- ``RK4``*: the torque constant on a step; ``RK4 linear``: linear on a step and continuous;
- ``Hermite-Simpson``: compressed, order 4, the torque quadratic on a step and continuous;
- ``Gauss 2``* to ``Gauss 6``*: collocation of order 4, 6, 8, 10 and 12 with the attitudes at the stages and the
  derivatives of the rates there as unknowns: rates follow by linear maps and torques from Euler's equation, ``u = J w'
  + w x J w``.

Units are those of ``casadi_slew``; the guess is the arc about the axis of the target, run through evenly, with all
rates zero.
"""

from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca
import numpy as np
from casadi_slew import HORIZON, SCALED_INERTIA, TORQUE_UNIT, quaternion_product
from repropagation import ANGLE, AXIS, Torque
from scipy.special import roots_legendre

SQUARE = ca.sumsqr


@dataclass(frozen=True)
class Attitude:
    """A parametrisation: its size, kinematics, the parameters of turns about an axis, and which of them an end
    prescribes.

    Schemes keep the norm of a quaternion, or nearly so: four equations at the end would be dependent.
    """

    size: int
    rate: Callable
    turn: Callable
    kept: np.ndarray


def rodrigues_rate(s, w):
    """Kinematics of modified Rodrigues parameters."""
    return ((1 - SQUARE(s)) * w + 2 * ca.cross(s, w) + 2 * ca.dot(s, w) * s) / 4


QUATERNION = Attitude(
    4,
    lambda q, w: quaternion_product(q, ca.vertcat(0, w)) / 2,
    lambda angles, axis: np.vstack([np.cos(angles / 2), np.outer(axis, np.sin(angles / 2))]),
    np.array([1, 2, 3]),
)
RODRIGUES = Attitude(3, rodrigues_rate, lambda angles, axis: np.outer(axis, np.tan(angles / 4)), np.arange(3))
ATTITUDES = {"quaternion": QUATERNION, "Rodrigues": RODRIGUES}


def torque_of(w, acceleration):
    """Euler's equation, scaled."""
    return SCALED_INERTIA * acceleration + ca.cross(w, SCALED_INERTIA * w)


def field(attitude, x, u):
    """Derivative of the state under a torque."""
    q, w = x[: attitude.size], x[attitude.size :]
    return ca.vertcat(attitude.rate(q, w), (u - ca.cross(w, SCALED_INERTIA * w)) / SCALED_INERTIA)


def rk4(attitude, h, x, torque):
    """One step of the classical method; ``torque`` at the fraction of the step."""
    k1 = field(attitude, x, torque(0))
    k2 = field(attitude, x + h / 2 * k1, torque(1 / 2))
    k3 = field(attitude, x + h / 2 * k2, torque(1 / 2))
    k4 = field(attitude, x + h * k3, torque(1))
    return x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


def rk4_constant(attitude, h, x0, x1, v):
    """Unknowns of a step: the torque. Value: what must vanish, the gap first; the cost; torques at the places."""
    return x1 - rk4(attitude, h, x0, lambda _: v), h / 2 * SQUARE(v), v


def rk4_linear(attitude, h, y0, y1, v):
    """Nodes carry the torque too."""
    (x0, u0), (x1, u1) = ((y[:-3], y[-3:]) for y in (y0, y1))
    cost = h / 6 * (SQUARE(u0) + ca.dot(u0, u1) + SQUARE(u1))
    return x1 - rk4(attitude, h, x0, lambda t: u0 + t * (u1 - u0)), cost, ca.horzcat(u0, u1)


def hermite_simpson(attitude, h, y0, y1, v):
    """Nodes carry the torque; unknown of a step: that in its middle."""
    (x0, u0), (x1, u1) = ((y[:-3], y[-3:]) for y in (y0, y1))
    f0, f1 = field(attitude, x0, u0), field(attitude, x1, u1)
    middle = field(attitude, (x0 + x1) / 2 + h / 8 * (f0 - f1), v)
    cost = h / 12 * (SQUARE(u0) + 4 * SQUARE(v) + SQUARE(u1))
    return x1 - x0 - h / 6 * (f0 + 4 * middle + f1), cost, ca.horzcat(u0, v, u1)


def gauss(stages):
    """Collocation; unknowns of a step: attitudes at the stages, then derivatives of the rates there."""
    places, weights = gauss_points(stages)
    matrix = np.array([[np.polyval(np.polyint(basis), c) for basis in lagrange(places)] for c in places])

    def step(attitude, h, x0, x1, v):
        k, (q0, w0) = attitude.size * stages, (x0[: attitude.size], x0[attitude.size :])
        q, a = ca.reshape(v[:k], attitude.size, stages), ca.reshape(v[k:], 3, stages)
        w = ca.repmat(w0, 1, stages) + h * a @ matrix.T
        slopes = ca.horzcat(*(attitude.rate(q[:, i], w[:, i]) for i in range(stages)))
        torques = ca.horzcat(*(torque_of(w[:, i], a[:, i]) for i in range(stages)))
        gap = x1 - x0 - h * ca.vertcat(slopes @ weights, a @ weights)
        inner = q - ca.repmat(q0, 1, stages) - h * slopes @ matrix.T
        return (
            ca.vertcat(gap, ca.vec(inner)),
            h / 2 * sum(weights[i] * SQUARE(torques[:, i]) for i in range(stages)),
            torques,
        )

    return step


def gauss_points(stages):
    """Places and weights on [0, 1]."""
    places, weights = roots_legendre(stages)
    return (places + 1) / 2, weights / 2


def lagrange(places):
    """Coefficients, highest first, of the polynomials that are one at one place and zero at the others."""
    return np.linalg.inv(np.vander(places)).T


@dataclass(frozen=True)
class Scheme:
    """A step, places of its torques, whether nodes carry torques, and the unknowns of a step: attitudes and vectors of
    three."""

    step: Callable
    places: np.ndarray
    torque_at_nodes: bool = False
    attitudes: int = 0
    vectors: int = 1


SCHEMES = {
    "RK4": Scheme(rk4_constant, np.zeros(1)),
    "RK4 linear": Scheme(rk4_linear, np.array([0.0, 1.0]), torque_at_nodes=True, vectors=0),
    "Hermite-Simpson": Scheme(hermite_simpson, np.array([0.0, 0.5, 1.0]), torque_at_nodes=True),
    "Gauss 2": Scheme(gauss(2), gauss_points(2)[0], attitudes=2, vectors=2),
    "Gauss 3": Scheme(gauss(3), gauss_points(3)[0], attitudes=3, vectors=3),
    "Gauss 4": Scheme(gauss(4), gauss_points(4)[0], attitudes=4, vectors=4),
    "Gauss 5": Scheme(gauss(5), gauss_points(5)[0], attitudes=5, vectors=5),
    "Gauss 6": Scheme(gauss(6), gauss_points(6)[0], attitudes=6, vectors=6),
}


class OrderedSlew:
    """The slew by a scheme in ``steps`` steps, with ``ipopt`` or ``fatrop``; built once for all targets.

    ``solve(target)`` returns the cost in N^2 m^2 s, by default for the target that all benchmarks share; what it takes
    is made from an angle below 180 degrees and an axis by ``target(angle, axis)``. ``torque()`` is the control of the
    last solution.
    """

    def __init__(self, scheme, steps, solver="ipopt", attitude="Rodrigues", tolerance=1e-10):
        self.scheme, self.steps, self.attitude = SCHEMES[scheme], steps, ATTITUDES[attitude]
        self.state = self.attitude.size + 3
        self.node = self.state + 3 * self.scheme.torque_at_nodes
        self.own = self.attitude.size * self.scheme.attitudes + 3 * self.scheme.vectors
        self.prescribed = np.concatenate([self.attitude.kept, self.attitude.size + np.arange(3)])  # of the last state
        y0, y1, v = ca.SX.sym("y0", self.node), ca.SX.sym("y1", self.node), ca.SX.sym("v", self.own)
        self._step = ca.Function("step", [y0, y1, v], list(self.scheme.step(self.attitude, 1 / steps, y0, y1, v)))
        self.solver, self._solver = solver, (self._ipopt if solver == "ipopt" else self._fatrop)(tolerance)
        self._usual = self.target(ANGLE, AXIS)

    def target(self, angle, axis):
        """Guess and end of the slew about an axis by an angle."""
        ends = np.zeros((2, self.state))
        ends[:, : self.attitude.size] = self.attitude.turn(np.array([0.0, angle]), axis).T
        arguments = {"x0": ca.DM(self._guess(angle, axis)), "lbg": 0, "ubg": 0}
        if self.solver == "fatrop":
            return arguments | {"p": ca.DM(np.concatenate([ends[0], ends[1, self.prescribed]]))}
        return arguments | self._bounds(ends)

    def solve(self, target=None):
        """The optimal cost; raises if the solver does not converge."""
        self.found = self._solver(**(target or self._usual))
        stats = self._solver.stats()
        if not stats["success"]:
            raise RuntimeError(f"no convergence: {stats['return_status']}")
        return float(self.found["f"]) * TORQUE_UNIT**2 * HORIZON

    def torque(self):
        """The control as polynomials in physical units."""
        table = np.asarray(self.found["x"]).ravel()
        last, table = table[-self.node :], table[: -self.node].reshape(self.steps, -1).T
        nodes = np.hstack([table[: self.node], last[:, None]])
        values = np.asarray(self._step.map(self.steps)(nodes[:, :-1], nodes[:, 1:], table[self.node :])[2])
        values = values.reshape(3, self.steps, -1).transpose(1, 2, 0) * TORQUE_UNIT
        return Torque(np.linspace(0, HORIZON, self.steps + 1), self.scheme.places, values)

    def _ipopt(self, tolerance):
        stride = self.node + self.own
        z = ca.MX.sym("z", stride * self.steps + self.node)
        table = ca.reshape(z[: -self.node], stride, self.steps)
        y = ca.horzcat(table[: self.node, :], z[-self.node :])
        residuals, costs, _ = self._step.map(self.steps)(y[:, :-1], y[:, 1:], table[self.node :, :])
        quiet = {"print_time": False, "ipopt.print_level": 0, "ipopt.sb": "yes", "expand": True}
        tuned = {"ipopt.tol": tolerance, "ipopt.mumps_permuting_scaling": 0, "ipopt.mumps_scaling": 0}
        return ca.nlpsol("slew", "ipopt", {"x": z, "f": ca.sum2(costs), "g": ca.vec(residuals)}, quiet | tuned)

    def _fatrop(self, tolerance):
        if self.scheme.torque_at_nodes:
            raise ValueError("FATROP takes steps that are explicit in the next state")
        x = [ca.MX.sym(f"x{k}", self.state) for k in range(self.steps + 1)]
        v = [ca.MX.sym(f"v{k}", self.own) for k in range(self.steps)]
        p = ca.MX.sym("p", self.state + len(self.prescribed))
        residuals, costs, _ = zip(*map(self._step, x[:-1], x[1:], v), strict=True)
        first, last = x[0] - p[: self.state], x[-1][self.prescribed.tolist()] - p[self.state :]
        g = ca.vertcat(residuals[0][: self.state], first, residuals[0][self.state :], *residuals[1:], last)
        z = ca.vertcat(*(part for pair in zip(x, v, strict=False) for part in pair), x[-1])
        options = {"print_time": False, "expand": True, "fatrop.print_level": 0, "fatrop.tol": tolerance}
        structure = {"structure_detection": "auto", "equality": [True] * g.numel()}
        return ca.nlpsol("slew", "fatrop", {"x": z, "f": sum(costs), "g": g, "p": p}, options | structure)

    def _guess(self, angle, axis):
        size, table = self.attitude.size, np.zeros((self.node + self.own, self.steps))
        begin = np.arange(self.steps)
        table[:size] = self.attitude.turn(angle * begin / self.steps, axis)
        for i in range(self.scheme.attitudes):
            there = self.attitude.turn(angle * (begin + self.scheme.places[i]) / self.steps, axis)
            table[self.node + i * size : self.node + (i + 1) * size] = there
        last = np.zeros(self.node)
        last[:size] = self.attitude.turn(np.array([angle]), axis)[:, 0]
        return np.concatenate([table.T.ravel(), last])

    def _bounds(self, ends):
        size = self.steps * (self.node + self.own) + self.node
        lower, upper = np.full(size, -np.inf), np.full(size, np.inf)
        lower[: self.state] = upper[: self.state] = ends[0]
        places = size - self.node + self.prescribed
        lower[places] = upper[places] = ends[1, self.prescribed]
        return {"lbx": ca.DM(lower), "ubx": ca.DM(upper)}
