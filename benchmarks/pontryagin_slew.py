"""Peer: Pontryagin's equations of the rest-to-rest slew, with SciPy's ``solve_bvp``.

With modified Rodrigues parameters ``s``, the body rate ``w``, the attitude's costate ``m`` in the body frame and the
torque ``u = J^-1 p`` of the rate's costate ``p``, the extremals of the cost ``int |u|^2 / 2`` obey

    s' = ((1 - |s|^2) w + 2 s x w + 2 (s . w) s) / 4        J w' = u - w x J w
    m' = m x w                                              J u' = -m + J w x u + J (u x w)

with ``s`` and ``w`` prescribed at both ends. Time is scaled by the horizon, inertia by the largest moment. The
right-hand side and its Jacobian are analytic and act on all mesh points at once.
"""

import numpy as np
from casadi_slew import ANGLE, AXIS, HORIZON, SCALED_INERTIA, TORQUE_UNIT
from repropagation import Torque
from scipy.integrate import solve_bvp

J = SCALED_INERTIA[:, None]
TARGET = AXIS * np.tan(ANGLE / 4)


def cross(a, b):
    """Cross products of columns."""
    return np.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def hats(a):
    """Matrices (3, 3, n) of ``b -> a x b``."""
    zero = np.zeros_like(a[0])
    return np.array([[zero, -a[2], a[1]], [a[2], zero, -a[0]], [-a[1], a[0], zero]])


def field(_, y):
    """Right-hand side for columns (12, n)."""
    s, w, m, u = y[:3], y[3:6], y[6:9], y[9:]
    square, along = np.sum(s * s, axis=0), np.sum(s * w, axis=0)
    turned = ((1 - square) * w + 2 * cross(s, w) + 2 * along * s) / 4
    momentum = J * w
    return np.concatenate(
        [turned, (u - cross(w, momentum)) / J, cross(m, w), (-m + cross(momentum, u)) / J + cross(u, w)]
    )


def jacobian(_, y):
    """Jacobians (12, 12, n)."""
    s, w, m, u = y[:3], y[3:6], y[6:9], y[9:]
    square, along, eye = np.sum(s * s, axis=0), np.sum(s * w, axis=0), np.eye(3)[..., None]
    outer, rows, inertia = np.einsum("in,jn->ijn", s, s), np.einsum("in,jn->ijn", w, s), np.diag(SCALED_INERTIA)
    hat_w, hat_u, hat_s = hats(w), hats(u), hats(s)
    out = np.zeros((12, 12, y.shape[1]))
    out[:3, :3] = (-2 * rows - 2 * hat_w + 2 * along * eye + 2 * np.einsum("in,jn->ijn", s, w)) / 4
    out[:3, 3:6] = ((1 - square) * eye + 2 * hat_s + 2 * outer) / 4
    turning = np.einsum("ijn,jk->ikn", hat_w, inertia) - hats(J * w)  # of w x J w
    out[3:6, 3:6], out[3:6, 9:] = -turning / J[..., None], eye / J[..., None]
    out[6:9, 3:6], out[6:9, 6:9] = hats(m), -hat_w
    out[9:, 3:6] = -np.einsum("ijn,jk->ikn", hat_u, inertia) / J[..., None] + hat_u
    out[9:, 6:9] = -np.eye(3)[..., None] / J[..., None]
    out[9:, 9:] = hats(J * w) / J[..., None] - hat_w
    return out


def ends(first, last):
    """Boundary conditions."""
    return np.concatenate([first[:3], first[3:6], last[:3] - TARGET, last[3:6]])


def ends_jacobian(first, last):
    """Their derivatives by both ends."""
    at_first, at_last = np.zeros((12, 12)), np.zeros((12, 12))
    at_first[:6, :6] = at_last[6:, :6] = np.eye(6)
    return at_first, at_last


class PontryaginSlew:
    """The slew to a tolerance of ``solve_bvp``, from the motion about the axis by ``3 t^2 - 2 t^3`` on ``steps``
    intervals."""

    def __init__(self, tolerance, steps=10):
        self.tolerance = tolerance
        t = np.linspace(0, 1, steps + 1)
        angle, rate, turn = ANGLE * t**2 * (3 - 2 * t), 6 * ANGLE * t * (1 - t), 6 * ANGLE * (1 - 2 * t)
        torque = np.outer(SCALED_INERTIA * AXIS, turn)
        # That of the torque if nothing couples.
        costate = np.outer(SCALED_INERTIA**2 * AXIS, np.full_like(t, 12 * ANGLE))
        self.mesh, self.guess = (
            t,
            np.concatenate([np.outer(AXIS, np.tan(angle / 4)), np.outer(AXIS, rate), costate, torque]),
        )
        self.found = None

    def solve(self):
        """The optimal cost in N^2 m^2 s; raises if there is no convergence."""
        found = solve_bvp(
            field,
            ends,
            self.mesh,
            self.guess,
            tol=self.tolerance,
            fun_jac=jacobian,
            bc_jac=ends_jacobian,
            max_nodes=100_000,
        )
        if not found.success:
            raise RuntimeError(f"no convergence: {found.message}")
        self.found, self.steps = found, len(found.x) - 1
        return self.torque().cost()

    def torque(self):
        """The control: cubic on each interval."""
        x, places = self.found.x, np.array([0, 1 / 3, 2 / 3, 1])
        times = (x[:-1, None] + np.diff(x)[:, None] * places).ravel()
        values = self.found.sol(times)[9:].T.reshape(len(x) - 1, 4, 3) * TORQUE_UNIT
        return Torque(x * HORIZON, places, values)
