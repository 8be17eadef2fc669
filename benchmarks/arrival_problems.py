"""Problems with many ways to go wrong, and guesses from which to solve them: far, random, resting, wrong by half a
turn."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from retrax.integrators import Guess, OptimalControlProblem
from retrax.manifolds import SE, SO, Euclidean, Manifold, Product, Sphere, hat
from retrax.retractions import Cayley, Midpoint, default_retraction
from scipy.spatial.transform import Rotation

KINDS, EACH = ("far", "random", "resting", "half turn"), 6
REST = np.zeros(3)
UP, DOWN = np.array([0.0, 0.0, 1.0]), np.array([0.0, 0.0, -1.0])


def rotation(*vector):
    """The rotation by a rotation vector."""
    return Rotation.from_rotvec(np.array(vector, float)).as_matrix()


@dataclass(frozen=True)
class Case:
    """A problem with its method, ends, horizon and steps.

    ``sizes``: of random vectors in its flat factors, of controls; ``turned``: the end wrong by half a turn about axis
    ``k``; ``target``: what guesses end at where the end is free.
    """

    problem: OptimalControlProblem
    method: Any
    start: Any
    end: Any
    horizon: float
    steps: int
    sizes: tuple[float, float]
    turned: Callable[[Any, int], Any]
    target: Any = None

    @property
    def call(self):
        """Arguments of ``solve``."""
        return self.problem, self.method, self.start, self.end, self.horizon, self.steps

    def guesses(self):
        """All guesses by their kinds."""
        return {kind: [self._guess(kind, k) for k in range(EACH)] for kind in KINDS}

    def _guess(self, kind, k):
        draw = np.random.default_rng([KINDS.index(kind), k])
        end, make = (
            self.end if self.target is None else self.target,
            partial(Guess.from_waypoints, self.problem, self.method),
        )
        if kind == "far":
            if k % 2:
                return self._rolled(draw)
            return self._steered(make([self.start, *self._points(draw, 1 + k // 2), end], self.steps), draw, 1.0)
        if kind == "random":
            points = self._points(draw, self.steps)
            states = jax.tree.map(lambda *leaves: np.stack(leaves), *points)
            return self._steered(make([self.start, end], self.steps)._replace(states=states), draw, 1.0)
        if kind == "half turn":
            return self._steered(make([self.start, self.turned(end, k % 3)], self.steps), draw, 0.1 * (k // 3))
        ways = [self.start], [end], [self.start, end]
        states = [
            way[min(len(way) * i // self.steps, len(way) - 1)] for way in (ways[k % 3],) for i in range(self.steps)
        ]
        states = jax.tree.map(lambda *leaves: np.stack(leaves), *states)
        return self._steered(make([self.start, end], self.steps)._replace(states=states), draw, 1e-3 * (k // 3))

    def _rolled(self, draw):
        """The trajectory of random controls that change slowly."""
        times = (np.arange(self.steps) + 0.5) / self.steps
        waves = np.cos(np.pi * times[:, None] * np.arange(3))
        moves = self.sizes[1] * waves @ draw.standard_normal((3, self.problem.controls.dimension))
        return Guess.from_controls(
            self.problem, self.method, self.start, self._controls(moves), self.horizon, self.steps
        )

    def _steered(self, guess, draw, size):
        """The guess with random controls."""
        moves = size * self.sizes[1] * draw.standard_normal((self.steps, self.problem.controls.dimension))
        return guess._replace(controls=self._controls(moves))

    def _controls(self, moves):
        rest = np.asarray(self.rest)
        return np.asarray(jax.vmap(lambda c: self.problem._steer(rest, c))(moves))

    @property
    def rest(self):
        """A control at rest: zero, or a point of a control manifold."""
        controls = self.problem.controls
        return np.zeros(controls.shape) if isinstance(controls, Euclidean) else np.array([1.0, 0.0])

    def _points(self, draw, count):
        return [self._point(self.problem.manifold, draw) for _ in range(count)]

    def _point(self, manifold: Manifold, draw):
        if isinstance(manifold, Product):
            return tuple(self._point(factor, draw) for factor in manifold.factors)
        if isinstance(manifold, Euclidean):
            return self.sizes[0] * draw.standard_normal(manifold.shape)
        return np.asarray(manifold.random_point(jax.random.key(int(draw.integers(2**31)))))


def effort(_, u):
    """``|u|^2 / 2``."""
    return u @ u / 2


def half_turn(k):
    """About one of the axes."""
    return rotation(*(np.pi * np.eye(3)[k]))


def sub_riemannian():
    """``R' = R hat(u1, u2, 0)``: turns about two body axes, towards one about the third."""
    Q = SO(3)
    problem = OptimalControlProblem(Q, lambda q, u: q @ hat(jnp.append(u, 0.0)), effort, 2)
    return Case(
        problem,
        Midpoint(default_retraction(Q)),
        np.eye(3),
        rotation(0.4, -0.3, 1.6),
        1.0,
        40,
        (1, 3),
        lambda q, k: q @ half_turn(k),
    )


def cart_pole():
    """Swing-up with the angle on a line; masses 1 and 0.3 kg, 0.5 m."""
    Q = Euclidean(4)

    def dynamics(q, u):
        _, angle, v, w = q
        s, c = jnp.sin(angle), jnp.cos(angle)
        inertia, pull, weight = 1.0 + 0.3 * s * s, 0.15 * w * w * s, 1.3 * 9.81 * s
        return jnp.stack(
            [v, w, (u[0] + pull + 0.3 * 9.81 * s * c) / inertia, -(u[0] * c + pull * c + weight) / (0.5 * inertia)]
        )

    problem = OptimalControlProblem(Q, dynamics, effort, 1)
    end = np.array([0.0, np.pi, 0.0, 0.0])
    return Case(
        problem,
        Midpoint(default_retraction(Q)),
        np.zeros(4),
        end,
        2.0,
        50,
        (2, 10),
        lambda q, k: q + np.pi * np.array([0.0, (1, -1, -2)[k], 0, 0]),
    )


def unicycle():
    """Parking sideways: on SE(2) with speed and rate of turn as controls."""
    Q = SE(2)
    problem = OptimalControlProblem(Q, lambda q, u: q @ Q.hat(jnp.stack([u[0], u[1], 0.0])), effort, 2)
    end = np.asarray(Q.pose(np.eye(2), np.array([0.3, 1.0])))
    turns = [
        Q.pose(np.diag([-1.0, -1.0]), np.zeros(2)),
        Q.pose(np.eye(2), np.array([-0.6, -2.0])),
        Q.pose(np.diag([-1.0, -1.0]), np.array([1.0, 0.0])),
    ]
    return Case(
        problem, Midpoint(default_retraction(Q)), np.eye(3), end, 1.0, 40, (1, 3), lambda q, k: np.asarray(q @ turns[k])
    )


def steered():
    """Swimming at speed one in a turning current, from one side of a hill's foot to the other: the control is a
    direction."""
    Q = Euclidean(2)

    def dynamics(q, u):
        return u + 0.3 * jnp.stack([-q[1], q[0]])

    problem = OptimalControlProblem(Q, dynamics, lambda q, u: 2 * jnp.exp(-2 * q @ q) + (q @ q) / 10, Sphere(1))
    return Case(
        problem,
        Midpoint(default_retraction(Q)),
        np.array([1.0, 0.0]),
        np.array([-1.0, 0.0]),
        4.0,
        40,
        (1, 1),
        lambda q, k: (-q, q + 2, -q - 1)[k],
    )


def slew():
    """A spacecraft's turn by 150 degrees in a minute, from rest to rest, in N m."""
    Q, inertia = SO(3) * Euclidean(3), np.array([5621.0, 4547.0, 2364.0])
    problem = OptimalControlProblem(
        Q, lambda q, u: (q[0] @ hat(q[1]), (u - jnp.cross(q[1], inertia * q[1])) / inertia), effort, 3
    )
    end = rotation(*(np.deg2rad(150.0) * np.array([1.0, 2.0, -2.0]) / 3.0)), REST
    return Case(
        problem,
        Midpoint(Cayley(Q)),
        (np.eye(3), REST),
        end,
        60.0,
        40,
        (0.1, 20),
        lambda q, k: (q[0] @ half_turn(k), q[1]),
    )


def pendulum():
    """Swing-up of a spherical pendulum by torques about all axes; its body also spins."""
    Q = Sphere(2) * Euclidean(3)

    def dynamics(q, u):
        x, w = q
        return jnp.cross(w, x), 9.81 * jnp.cross(x, DOWN) + u

    problem = OptimalControlProblem(Q, dynamics, effort, 3)
    return Case(
        problem,
        Midpoint(default_retraction(Q)),
        (DOWN, REST),
        (UP, REST),
        2.0,
        40,
        (3, 5),
        lambda q, k: (half_turn(k) @ q[0], q[1]),
    )


def docking():
    """A free body with forces and moments, to a pose half a turn away."""
    Q, G = SE(3) * Euclidean(6), SE(3)
    inertia = np.array([1.0, 1.7, 2.3, 2.0, 2.0, 2.0])

    def dynamics(q, u):
        x, twist = q
        w, momentum = twist[:3], inertia * twist
        turn = jnp.concatenate([jnp.cross(momentum[:3], w), jnp.cross(momentum[3:], w)])
        return x @ G.hat(twist), (u + turn) / inertia

    problem = OptimalControlProblem(Q, dynamics, effort, 6)
    end = np.asarray(G.pose(rotation(2.9, 0.3, -0.4), np.array([3.0, -2.0, 1.0]))), np.zeros(6)
    half = [np.asarray(G.pose(half_turn(k), np.zeros(3))) for k in range(3)]
    return Case(
        problem,
        Midpoint(default_retraction(Q)),
        (np.eye(4), np.zeros(6)),
        end,
        5.0,
        30,
        (1, 2),
        lambda q, k: (q[0] @ half[k], q[1]),
    )


def ball():
    """A ball that rolls on a plane without slipping or spinning, back to where it was, turned about the vertical."""
    Q = Euclidean(2) * SO(3)
    problem = OptimalControlProblem(Q, lambda q, u: (u, hat(jnp.stack([-u[1], u[0], 0.0])) @ q[1]), effort, 2)
    end = np.array([0.5, 0.0]), rotation(0.3, 0.2, 1.5)
    return Case(
        problem,
        Midpoint(default_retraction(Q)),
        (np.zeros(2), np.eye(3)),
        end,
        1.0,
        40,
        (2, 5),
        lambda q, k: (q[0], q[1] @ half_turn(k)),
    )


def landing():
    """A free end with a strong cost on it, on the sphere."""
    Q, current = Sphere(2), np.array([0.0, 0.1, 0.4])
    first, second = np.array([0.0, 0.6, 0.8]), np.array([0.1, 0.6, 0.8])
    problem = OptimalControlProblem(
        Q,
        lambda q, u: jnp.cross(u + current, q),
        lambda q, u: u @ u / 2 + q[0] / 10,
        3,
        terminal_cost=lambda q: 3 * (q - first) @ (q - second) + q[0] ** 3 / 2,
    )
    return Case(
        problem,
        Midpoint(default_retraction(Q)),
        np.array([1.0, 0.0, 0.0]),
        None,
        1.0,
        20,
        (1, 3),
        lambda q, k: half_turn(k) @ q,
        first,
    )


CASES = {
    "sub-Riemannian SO(3)": sub_riemannian,
    "cart-pole swing-up": cart_pole,
    "unicycle on SE(2)": unicycle,
    "control on a circle": steered,
    "150 degree slew": slew,
    "spherical pendulum": pendulum,
    "docking on SE(3)": docking,
    "rolling ball": ball,
    "free end on the sphere": landing,
}
