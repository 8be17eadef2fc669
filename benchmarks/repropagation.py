"""What a control of the rest-to-rest slew does: propagated from the start, by SciPy's DOP853, to the attitude at the
end.

The one measure of accuracy that all transcriptions share: no library compared has a part in it.
"""

from dataclasses import dataclass

import numpy as np

INERTIA = np.array([5621.0, 4547.0, 2364.0])  # kg m^2
ANGLE, AXIS = np.deg2rad(150.0), np.array([1.0, 2.0, -2.0]) / 3
RELATIVE, ABSOLUTE = 1e-12, 1e-14


@dataclass(frozen=True)
class Torque:
    """A torque (N m) that is a polynomial on each interval: ``values`` (N, s, 3) at ``places`` (s,), fractions of the
    interval.

    ``times`` (N + 1,), in seconds, bound the intervals.
    """

    times: np.ndarray
    places: np.ndarray
    values: np.ndarray

    def coefficients(self):
        """Coefficients (N, s, 3), the constant first, in the fraction of the interval."""
        return np.linalg.inv(np.vander(self.places, increasing=True)) @ self.values

    def cost(self):
        """``int |u|^2 / 2`` in N^2 m^2 s, exact for the polynomials."""
        a, powers = self.coefficients(), np.arange(len(self.places))
        integrals = np.einsum("kix,kjx,ij->k", a, a, 1 / (1 + powers[:, None] + powers))
        return float(integrals @ np.diff(self.times) / 2)


def attitude_error(torque, angle=ANGLE, axis=AXIS):
    """Angle (rad) between the attitude at the end and the target, a turn, when the torque acts from rest at the
    identity."""
    from scipy.integrate import solve_ivp  # not part of a cold start that is measured

    state = np.concatenate([[1.0], np.zeros(6)])
    for begin, end, coefficients in zip(torque.times, torque.times[1:], torque.coefficients(), strict=False):
        powers, length = np.arange(len(coefficients)), end - begin

        def field(t, y, length=length, coefficients=coefficients, powers=powers):
            q, w = y[:4], y[4:]
            u = (t / length) ** powers @ coefficients
            turned = np.concatenate([[-q[1:] @ w], q[0] * w + np.cross(q[1:], w)]) / 2
            return np.concatenate([turned, (u - np.cross(w, INERTIA * w)) / INERTIA])

        state = solve_ivp(field, (0, length), state, "DOP853", rtol=RELATIVE, atol=ABSOLUTE).y[:, -1]
    target = np.concatenate([[np.cos(angle / 2)], axis * np.sin(angle / 2)])
    found = state[:4] / np.linalg.norm(state[:4])
    sign = np.sign(found @ target)
    return float(4 * np.arctan2(np.linalg.norm(found - sign * target), np.linalg.norm(found + sign * target)))
