"""The rest-to-rest slew of ``casadi_slew`` with retrax."""

import jax
import jax.numpy as jnp
import numpy as np
from repropagation import ANGLE, AXIS, INERTIA, Torque
from retrax.integrators import Free, OptimalControlProblem, Solver
from retrax.manifolds import SO, Euclidean, hat
from retrax.retractions import Cayley, Gauss, Midpoint

jax.config.update("jax_enable_x64", True)

HORIZON = 60.0  # s
STATES = SO(3) * Euclidean(3)  # attitude, body rate (rad/s)
RETRACTION = Cayley(STATES)


def slew_problem(inertia=INERTIA, torque_limit=None, cost=lambda q, u: u @ u / 2):
    """``R' = R hat(w)``, ``J w' = u - w x J w``, cost ``int |u|^2 / 2``, as functions made anew; limits of each torque,
    N m."""
    bounds = None if torque_limit is None else (-torque_limit, torque_limit)
    inertia = np.asarray(inertia)

    def dynamics(q, u):
        attitude, rate = q
        return attitude @ hat(rate), (u - jnp.cross(rate, inertia * rate)) / inertia

    return OptimalControlProblem(STATES, dynamics, cost, controls=3, control_bounds=bounds)


def turns(angles, axes):
    """Rotation matrices (n, 3, 3) by angles about unit axes (n, 3)."""
    cross = np.cross(axes[:, None], -np.eye(3))
    sine, rest = np.sin(angles)[:, None, None], (1 - np.cos(angles))[:, None, None]
    return np.eye(3) + sine * cross + rest * cross @ cross


def at_rest(attitudes):
    """States with these attitudes and no rate."""
    return attitudes, np.zeros((*attitudes.shape[:-2], 3))


class RetraxSlew:
    """The slew by Gauss collocation with some stages, one being the midpoint scheme; built once, ``solve`` for any
    target."""

    def __init__(self, steps, stages=1, tolerance=1e-8, inertia=INERTIA, torque_limit=None, evaluator="automatic"):
        method = Midpoint(RETRACTION) if stages == 1 else Gauss(stages, RETRACTION)
        self.steps, self.stages, self.tolerance = steps, stages, tolerance
        self.solver = Solver(slew_problem(inertia, torque_limit), method, steps, evaluator=evaluator)
        self.start, self.end = at_rest(np.eye(3)), at_rest(turns(np.array([ANGLE]), AXIS[None])[0])

    def solve(self, end=None):
        """The optimal cost in N^2 m^2 s; raises if the solver does not converge."""
        end = self.end if end is None else end
        self.found = self.solver.solve(self.start, end, HORIZON, tolerance=self.tolerance)
        return self.found.cost

    def torque(self):
        """The control of the last solution."""
        return polynomials(self.found.times, self.found.stage_times, self.found.controls)


class LeastTimeSlew:
    """The slew in the least time with limited torques, by the midpoint scheme; built once."""

    def __init__(self, steps, torque_limit, tolerance=1e-8):
        problem = slew_problem(torque_limit=torque_limit, cost=lambda q, u: 1.0)
        self.solver, self.tolerance = Solver(problem, Midpoint(RETRACTION), steps), tolerance
        self.start, self.end = at_rest(np.eye(3)), at_rest(turns(np.array([ANGLE]), AXIS[None])[0])

    def solve(self):
        """The least horizon in s, from a guess of ``HORIZON``; raises if the solver does not converge."""
        self.found = self.solver.solve(self.start, self.end, Free(HORIZON), tolerance=self.tolerance)
        return self.found.cost


def polynomials(times, stage_times, controls):
    """Controls at the stages of steps as polynomials of time."""
    values = np.asarray(controls).reshape(len(times) - 1, -1, 3)
    places = (np.asarray(stage_times).ravel()[: values.shape[1]] - times[0]) / (times[1] - times[0])
    return Torque(np.asarray(times), places, values)
