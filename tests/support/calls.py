"""Calls as users write them, with the types that a checker must find: type checkers read this file without settings."""

from typing import assert_type

import jax
import jax.numpy as jnp
import numpy as np
import retrax as rx
from retrax.integrators import Phase, Solution, solve_phases


class Circle(rx.manifolds.LevelSet):
    def constraint(self, x: jax.Array) -> jax.Array:
        return x @ x - 1.0


class Parabola(rx.manifolds.LevelSet):
    shape = (2,)  # of all manifolds of the class

    def constraint(self, x: jax.Array) -> jax.Array:
        return x[1] - x[0] ** 2


class Line(rx.manifolds.LevelSet):
    shape = 2
    slope: float

    def constraint(self, x: jax.Array) -> jax.Array:
        return x[1] - self.slope * x[0]


class Ring(rx.manifolds.LevelSet):
    shape: tuple[int, ...] = (2,)

    def constraint(self, x: jax.Array) -> jax.Array:
        return x @ x - 4.0


class Ellipsoid(rx.manifolds.LevelSet):
    weights: jax.Array

    def constraint(self, x: jax.Array) -> jax.Array:
        return x @ (self.weights * x) - 1.0


Q = rx.Euclidean(2)
START, END = np.zeros(2), np.ones(2)


def with_parameters(q, u, mass):
    return jnp.stack([q[1], u[0] / mass])


def with_time(q, u, t):
    return jnp.stack([q[1], u[0] * t])


problem = rx.OptimalControlProblem(Q, with_parameters, lambda q, u: u @ u / 2, controls=1)
timed = rx.OptimalControlProblem(
    Q, with_time, lambda q, u, t: t * (u @ u), 1, terminal_cost=lambda q, t: q @ q, time_dependent=True
)
method = rx.Gauss(3, rx.Exponential(Q))
free = rx.solve(problem, START, END, horizon=rx.Free(5.0), parameters=1.0)
solver = rx.Solver(problem, method, 20)
again = solver.solve(START, END, rx.Free(5.0, 1.0, 10.0), guess=free, parameters=1.0)
phases = [Phase(problem, method, 20, rx.Free(1.0), parameters=2.0), Phase(problem, method, 20, 1.0, end=END)]
flown = solve_phases(phases, boundary_constraints={"at rest": lambda ends: ends[0].start}, horizon=3.0)

assert_type(free, Solution)
assert_type(again, Solution)
lengths: list[int] = [len(free.states), len(free.u), free.controls.ndim, flown.phases[0].states.ndim]
error: float = free.checks.error
shapes: list[tuple[int, ...]] = [Circle(shape=2).shape, Circle(shape=(3, 3)).shape, Parabola().shape, Ring().shape]
shapes += [Ellipsoid(shape=3, weights=jnp.ones(3)).shape]
dimension: int = Line(slope=2.0).dimension
units: str = free.quantities.time
product = rx.SO(3) * rx.Euclidean((2, 3))
attitudes, others = rx.solve(problem, None, END, 1.0).states
