"""Peer: the rest-to-rest slew with crocoddyl, a spherical joint of Pinocchio, RK4 steps, and its FDDP solver.

Pinocchio gives the derivatives analytically, attitudes are its unit quaternions. FDDP takes no hard condition at the
end: the squared distance to it is a cost with a large weight, whose effect on the attitude is below the errors that are
reported here. The torque is constant on a step. Units are those of ``casadi_slew``.
"""

import crocoddyl
import numpy as np
import pinocchio
from repropagation import ANGLE, AXIS, INERTIA, Torque

HORIZON = 60.0  # s
TORQUE_UNIT = INERTIA.max() / HORIZON**2  # N m


class CrocoddylSlew:
    """The slew in ``steps`` steps; built once, ``solve`` from the motion about the eigenaxis at zero rates."""

    def __init__(self, steps, weight=1e8, tolerance=1e-9):
        self.steps = steps
        model = pinocchio.Model()
        joint = model.addJoint(0, pinocchio.JointModelSpherical(), pinocchio.SE3.Identity(), "body")
        inertia = pinocchio.Inertia(1.0, np.zeros(3), np.diag(INERTIA / INERTIA.max()))
        model.appendBodyToJoint(joint, inertia, pinocchio.SE3.Identity())
        model.gravity.linear = np.zeros(3)
        self.state = crocoddyl.StateMultibody(model)
        self.problem = self._problem(1 / steps, weight)
        self.solver = crocoddyl.SolverFDDP(self.problem)
        self.solver.th_stop = tolerance
        angles = ANGLE * np.arange(steps + 1) / steps
        self.states = [self._state(angle) for angle in angles]
        self.controls = [np.zeros(3)] * steps

    @staticmethod
    def _state(angle):
        return np.concatenate([AXIS * np.sin(angle / 2), [np.cos(angle / 2)], np.zeros(3)])

    def _problem(self, h, weight):
        actuation = crocoddyl.ActuationModelFull(self.state)
        effort, end = crocoddyl.CostModelSum(self.state, 3), crocoddyl.CostModelSum(self.state, 3)
        effort.addCost(
            "torque", crocoddyl.CostModelResidual(self.state, crocoddyl.ResidualModelControl(self.state, 3)), 1.0
        )
        distance = crocoddyl.ResidualModelState(self.state, self._state(ANGLE), 3)
        end.addCost("end", crocoddyl.CostModelResidual(self.state, distance), weight)
        running, last = (
            crocoddyl.DifferentialActionModelFreeFwdDynamics(self.state, actuation, c) for c in (effort, end)
        )
        held = crocoddyl.ControlParametrizationModelPolyZero(3)
        step = crocoddyl.IntegratedActionModelRK(running, held, crocoddyl.RKType.four, h)
        last = crocoddyl.IntegratedActionModelEuler(last, 0.0)
        problem = crocoddyl.ShootingProblem(self._state(0.0), [step] * self.steps, last)
        problem.nthreads = 1  # steps this small are not worth a thread
        return problem

    def solve(self):
        """The cost of the torque in N^2 m^2 s; raises if FDDP does not converge."""
        if not self.solver.solve(self.states, self.controls, 100, False):
            raise RuntimeError(f"no convergence after {self.solver.iter} iterations, stop {self.solver.stop:.1e}")
        return self.torque().cost()

    def torque(self):
        """The control in physical units."""
        values = np.array(self.solver.us.tolist()).reshape(self.steps, -1, 3) * TORQUE_UNIT
        return Torque(np.linspace(0, HORIZON, self.steps + 1), np.zeros(1), values)
