"""Peer: the rest-to-rest spacecraft slew as a sparse nonlinear program, in CasADi with IPOPT (or FATROP).

The unknowns at the nodes ``t_k = k h``, ``h = T / N``, are the unit quaternion ``q_k`` (scalar first) and the body rate
``w_k`` (rad/s). The implicit midpoint rule, with ``q = (q_k + q_{k+1}) / 2`` and ``w = (w_k + w_{k+1}) / 2``, is

    q_{k+1} - q_k = h/2 q * (0, w),        J (w_{k+1} - w_k) = h (u_k - w x J w),        minimize  h/2 sum_k |u_k|^2

with the torque ``u_k`` (N m) constant on a step. The rule keeps ``|q_k|``, so the last quaternion is prescribed by
three of its components: four would make the constraints dependent. Inside the solver the unit of time is the horizon
and the unit of inertia the largest principal moment, so that no unknown exceeds about ten.

Three transcriptions of this one discrete problem are at hand; they have the same optimum, node by node:

- ``CasadiSlew(steps)``: the torque replaced by its value from the second equation; the fastest with IPOPT, the default;
- ``CasadiSlew(steps, torque_variables=True)``: the torque an unknown and both equations constraints;
- ``FatropSlew(steps)``: ``w_{k+1}`` the control of step ``k`` and the first equation solved for ``q_{k+1}``, the form
  of an explicit discrete system that FATROP, an interior-point method with a Riccati recursion, asks for.
"""

import statistics
import time

import casadi as ca
import numpy as np

INERTIA = np.array([5621.0, 4547.0, 2364.0])  # kg m^2
HORIZON = 60.0  # s
ANGLE = np.deg2rad(150.0)
AXIS = np.array([1.0, 2.0, -2.0]) / 3.0
OPTIMUM = 2504.24655710  # N^2 m^2 s, the limit of the optimal cost as steps grow; the scheme is of order 2

SCALED_INERTIA = INERTIA / INERTIA.max()
TORQUE_UNIT = INERTIA.max() / HORIZON**2  # N m
STATE = 7  # q and w
TARGET = np.concatenate([[np.cos(ANGLE / 2)], AXIS * np.sin(ANGLE / 2)])
GUESSES = ("linear", "smooth")


def quaternion_product(a, b):
    """The product ``a * b``, scalar parts first."""
    return ca.vertcat(a[0] * b[0] - ca.dot(a[1:], b[1:]), a[0] * b[1:] + b[0] * a[1:] + ca.cross(a[1:], b[1:]))


def midpoint_torque(h, w0, w1):
    """``J (w1 - w0) / h + w x J w`` at the mean rate, scaled."""
    w = (w0 + w1) / 2
    return SCALED_INERTIA * (w1 - w0) / h + ca.cross(w, SCALED_INERTIA * w)


def midpoint_step(h, torque_variables):
    """The function ``(x0, x1, u) -> (residual, cost)`` of one step, ``u`` empty where the torque is eliminated."""
    x0, x1 = ca.SX.sym("x0", STATE), ca.SX.sym("x1", STATE)
    u = ca.SX.sym("u", 3 if torque_variables else 0)
    torque = u if torque_variables else midpoint_torque(h, x0[4:], x1[4:])
    return ca.Function("step", [x0, x1, u], [_residual(h, x0, x1, u), h / 2 * ca.sumsqr(torque)])


def _residual(h, x0, x1, u):
    """What the rule lacks in a step, without the second equation where the torque ``u`` is empty."""
    q, w = (x0[:4] + x1[:4]) / 2, (x0[4:] + x1[4:]) / 2
    turned = x1[:4] - x0[:4] - h / 2 * quaternion_product(q, ca.vertcat(0, w))
    return ca.vertcat(turned, h * (midpoint_torque(h, x0[4:], x1[4:]) - u)) if u.numel() else turned


def explicit_step(h):
    """The function ``(x0, w1) -> (x1, cost)``: ``q1 = q0 * (1, a) * (1, -a)^-1``, ``a = h w / 4``, solves the rule."""
    x0, w1 = ca.SX.sym("x0", STATE), ca.SX.sym("w1", 3)
    a = h / 8 * (x0[4:] + w1)
    turn = ca.vertcat(1 - ca.sumsqr(a), 2 * a) / (1 + ca.sumsqr(a))
    torque = midpoint_torque(h, x0[4:], w1)
    x1 = ca.vertcat(quaternion_product(x0[:4], turn), w1)
    return ca.Function("step", [x0, w1], [x1, h / 2 * ca.sumsqr(torque)])


def guess_states(steps, kind):
    """Scaled node states (7, steps + 1) on the arc to the target: angle and rate over the time ``s`` from 0 to 1.

    ``linear``: the angle ``s`` times the whole, with zero rates; ``smooth``: ``3 s^2 - 2 s^3`` times the whole, with
    the rates of that motion, which start and end at rest.
    """
    if kind not in GUESSES:
        raise ValueError(f"guess is {kind!r}, expected one of {GUESSES}")
    s = np.linspace(0.0, 1.0, steps + 1)
    angle, rate = (ANGLE * s, 0.0 * s) if kind == "linear" else (ANGLE * s**2 * (3 - 2 * s), 6 * ANGLE * s * (1 - s))
    return np.vstack([np.cos(angle / 2), np.outer(AXIS, np.sin(angle / 2)), np.outer(AXIS, rate)])


def guess_torques(states, kind):
    """Scaled torques (3, steps) of a guess: zero, or for ``smooth`` those of the midpoint rule for its rates."""
    steps = states.shape[1] - 1
    if kind == "linear":
        return np.zeros((3, steps))
    w, change = (states[4:, 1:] + states[4:, :-1]) / 2, np.diff(states[4:])
    inertia = SCALED_INERTIA[:, None]
    return inertia * change * steps + np.cross(w, inertia * w, axis=0)


def prescribed_end():
    """The indices and values of the last state that are prescribed: all but the largest component of the quaternion."""
    free = np.argmax(np.abs(TARGET))
    kept = np.delete(np.arange(STATE), free)
    return kept, np.concatenate([TARGET, np.zeros(3)])[kept]


class CasadiSlew:
    """The slew in ``steps`` steps with IPOPT: exact Hessian, MUMPS, the ends prescribed by bounds.

    The solver is built once; every ``solve()`` starts from the same ``guess`` (``linear`` or ``smooth``), so the second
    call is the warm re-solve of a built solver. ``options`` are further options of ``casadi.nlpsol``; ``jit=True``
    compiles the derivatives of one step with the system's C compiler and maps them over the steps. ``torque_limit``, N
    m, bounds each component of torques that are variables.

    Attributes: ``build_seconds``; after a solve ``iterations`` and ``solve_seconds``, the wall time of that call.
    """

    def __init__(self, steps, guess="linear", torque_variables=False, jit=False, options=None, torque_limit=np.inf):
        start = time.perf_counter()
        self.steps, self.guess, self.torque_variables, self.torque_limit = steps, guess, torque_variables, torque_limit
        self.iterations = self.solve_seconds = None
        self._solver = self._build(jit, options or {})
        self._arguments = self._start_and_bounds()
        self.build_seconds = time.perf_counter() - start

    @property
    def _stride(self):
        """Unknowns per step."""
        return STATE + (3 if self.torque_variables else 0)

    def _build(self, jit, options):
        step = midpoint_step(1.0 / self.steps, self.torque_variables)
        z = ca.MX.sym("z", self._stride * self.steps + STATE)
        table = ca.reshape(z[:-STATE], self._stride, self.steps)
        x = ca.horzcat(table[:STATE, :], z[-STATE:])
        residuals, costs = step.map(self.steps)(x[:, :-1], x[:, 1:], table[STATE:, :])
        program = {"x": z, "f": ca.sum2(costs), "g": ca.vec(residuals)}
        return ca.nlpsol("slew", "ipopt", program, self._defaults(jit) | options)

    @staticmethod
    def _defaults(jit):
        """Quiet; the unknowns are scaled already, so MUMPS need not scale them again."""
        quiet = {"print_time": False, "ipopt.print_level": 0, "ipopt.sb": "yes"}
        tuned = {"ipopt.tol": 1e-8, "ipopt.mumps_permuting_scaling": 0, "ipopt.mumps_scaling": 0}
        compiled = {"jit": True, "compiler": "shell", "jit_options": {"flags": ["-O3"], "verbose": False}}
        return quiet | tuned | {"expand": not jit} | (compiled if jit else {})

    def _start_and_bounds(self):
        states = guess_states(self.steps, self.guess)
        inner = states[:, :-1]
        if self.torque_variables:
            inner = np.vstack([inner, guess_torques(states, self.guess)])
        z = np.concatenate([inner.T.ravel(), states[:, -1]])
        lower, upper = np.full(z.size, -np.inf), np.full(z.size, np.inf)
        if self.torque_variables:
            torques = upper[:-STATE].reshape(self.steps, -1)[:, STATE:]
            torques[:] = self.torque_limit / TORQUE_UNIT
            lower[:-STATE] = -upper[:-STATE]
        lower[:STATE] = upper[:STATE] = np.eye(STATE)[0]
        kept, values = prescribed_end()
        lower[z.size - STATE + kept] = upper[z.size - STATE + kept] = values
        return {"x0": ca.DM(z), "lbx": ca.DM(lower), "ubx": ca.DM(upper), "lbg": 0, "ubg": 0}

    def solve(self):
        """Solve from the guess: the cost in N^2 m^2 s and the node states (steps + 1, 7), the rates in rad/s."""
        start = time.perf_counter()
        found = self._solver(**self._arguments)
        self.solve_seconds = time.perf_counter() - start
        stats = self._solver.stats()
        self.iterations = stats["iter_count"]
        if not stats["success"]:
            raise RuntimeError(f"the slew in {self.steps} steps did not converge: {stats['return_status']}")
        return self._of(found)

    def _of(self, found):
        z = np.asarray(found["x"]).ravel()
        return float(found["f"]) * TORQUE_UNIT**2 * HORIZON, self._nodes(z)

    def _nodes(self, z):
        nodes = np.vstack([z[:-STATE].reshape(self.steps, -1)[:, :STATE], z[-STATE:]])
        return nodes / np.array([1.0] * 4 + [HORIZON] * 3)


class LeastTimeSlew(CasadiSlew):
    """The slew in the least time with limited torques: the horizon is an unknown too, the last one.

    ``solve`` starts from the guess and ``HORIZON``, and returns the least horizon, s, and the node states.
    """

    def __init__(self, steps, torque_limit, guess="linear"):
        super().__init__(steps, guess, torque_variables=True, torque_limit=torque_limit)

    def _build(self, jit, options):
        horizon, h = ca.MX.sym("T"), ca.SX.sym("h")
        x0, x1, u = ca.SX.sym("x0", STATE), ca.SX.sym("x1", STATE), ca.SX.sym("u", 3)
        step = ca.Function("step", [x0, x1, u, h], [_residual(h, x0, x1, u)])
        z = ca.MX.sym("z", self._stride * self.steps + STATE)
        table = ca.reshape(z[:-STATE], self._stride, self.steps)
        x = ca.horzcat(table[:STATE, :], z[-STATE:])
        each = ca.repmat(horizon / self.steps, 1, self.steps)
        residuals = step.map(self.steps)(x[:, :-1], x[:, 1:], table[STATE:, :], each)
        program = {"x": ca.vertcat(z, horizon), "f": horizon, "g": ca.vec(residuals)}
        return ca.nlpsol("slew", "ipopt", program, self._defaults(jit) | options)

    def _start_and_bounds(self):
        own = super()._start_and_bounds()
        ends = {"x0": 1.0, "lbx": 0.0, "ubx": np.inf}
        return own | {name: ca.vertcat(own[name], value) for name, value in ends.items()}

    def _of(self, found):
        z = np.asarray(found["x"]).ravel()
        return float(z[-1]) * HORIZON, self._nodes(z[:-1])


class FatropSlew(CasadiSlew):
    """The slew in ``steps`` steps with FATROP: the same optimum, attributes and ``solve`` as :class:`CasadiSlew`."""

    def __init__(self, steps, guess="linear", options=None):
        super().__init__(steps, guess, torque_variables=True, options=options)

    def _build(self, jit, options):
        step = explicit_step(1.0 / self.steps)
        x = [ca.MX.sym(f"x{k}", STATE) for k in range(self.steps + 1)]
        v = [ca.MX.sym(f"v{k}", 3) for k in range(self.steps)]
        images, costs = zip(*map(step, x[:-1], v), strict=True)
        gaps = [after - image for after, image in zip(x[1:], images, strict=True)]
        kept, values = prescribed_end()
        ends = [x[0] - ca.DM(np.eye(STATE)[0]), x[-1][kept.tolist()] - ca.DM(values)]
        g = ca.vertcat(gaps[0], ends[0], *gaps[1:], ends[1])
        z = ca.vertcat(*(part for pair in zip(x, v, strict=False) for part in pair), x[-1])
        defaults = {"print_time": False, "expand": True, "fatrop.print_level": 0, "fatrop.tol": 1e-8}
        structure = {"structure_detection": "auto", "equality": [True] * g.numel()}
        return ca.nlpsol("slew", "fatrop", {"x": z, "f": sum(costs), "g": g}, defaults | structure | options)

    def _start_and_bounds(self):
        states = guess_states(self.steps, self.guess)
        z = np.concatenate([np.vstack([states[:, :-1], states[4:, 1:]]).T.ravel(), states[:, -1]])
        return {"x0": ca.DM(z), "lbg": 0, "ubg": 0}


def warm_seconds(slew, repeats=21):
    """The median wall time of ``repeats`` re-solves, in seconds, once the solver is warm."""
    slew.solve()
    times = []
    for _ in range(repeats):
        slew.solve()
        times.append(slew.solve_seconds)
    return statistics.median(times)


def variants(steps, guess):
    """Name and built solver of every transcription compared."""
    yield "IPOPT", CasadiSlew(steps, guess)
    yield "IPOPT, torque variables", CasadiSlew(steps, guess, torque_variables=True)
    yield "IPOPT, compiled", CasadiSlew(steps, guess, jit=True)
    yield "FATROP", FatropSlew(steps, guess)


def main():
    """Print iterations, times and the distance of the cost from its limit for each transcription, guess and size."""
    titles = f"{'N':>4} {'guess':<7}{'solver':<25}{'iters':>6}{'build s':>9}"
    print(f"{titles}{'first ms':>10}{'warm ms':>9}{'cost - limit':>14}")
    for steps in (50, 100, 200, 400):
        for guess in GUESSES:
            for name, slew in variants(steps, guess):
                cost, _ = slew.solve()
                first, warm = 1e3 * slew.solve_seconds, 1e3 * warm_seconds(slew)
                row = f"{steps:>4} {guess:<7}{name:<25}{slew.iterations:>6}{slew.build_seconds:>9.3f}"
                print(f"{row}{first:>10.2f}{warm:>9.2f}{cost - OPTIMUM:>14.8f}", flush=True)


if __name__ == "__main__":
    main()
