"""Second derivatives of small functions at many points: tapes beside XLA and beside CasADi's own machine.

    python benchmarks/tape.py [--points 1 100 10000] [--repeats 11]

Each function is that of one point of a problem of mechanics; wanted are its gradient and its Hessian. `cold` is the
first call of a new function with all that it builds, after one of another kind has run; `warm` the median of the next
ones, in turns, in one run. One JSON line for each function and number of points; the largest relative difference from
XLA's values comes with it.
"""

import argparse
import json
import statistics
import time

import casadi as ca
import jax
import jax.numpy as jnp
import numpy as np
from retrax.manifolds import SE, SO, Euclidean, Sphere, hat
from retrax.manifolds.numerics import ambient as vec
from retrax.retractions import Cayley, Exponential, Midpoint, Projection
from retrax.tape import Tape

INERTIA = jnp.array([5621.0, 4547.0, 2364.0])


def lagrangian(discretization, velocity, cost, controls):
    """``S = <p1, R2> - <p0, R1> - h F`` of a step in a chart around its base point."""
    retraction = discretization.retraction

    def function(d, x, u, p0, p1):
        n = discretization.manifold.dimension
        base, control = retraction.chart(x, retraction.frame(x), d[:n]), u + d[n:]
        begin, end = discretization(base, vec.scale(0.5, velocity(base, control)))
        return vec.pairing(p1, end) - vec.pairing(p0, begin) - 0.5 * cost(base, control)

    x = discretization.manifold.random_point(jax.random.key(0))
    return function, (jnp.zeros(discretization.manifold.dimension + controls), x, jnp.ones(controls), x, x)


def slew(q, u):
    """Attitude and body rate of a rigid body under a torque."""
    attitude, rate = q
    return attitude @ hat(rate), (u - jnp.cross(rate, INERTIA * rate)) / INERTIA


def cases():
    """Functions with an example of their arguments, the first of which is differentiated."""
    energy = lambda q, u: u @ u / 2  # noqa: E731  # the cost of every case
    yield "slew on SO(3) x R^3, Cayley", *lagrangian(Midpoint(Cayley(SO(3) * Euclidean(3))), slew, energy, 3)
    yield "slew on SO(3) x R^3, exponential", *lagrangian(Midpoint(Exponential(SO(3) * Euclidean(3))), slew, energy, 3)
    sphere = Midpoint(Projection(Sphere(2)))
    yield "S^2, projection", *lagrangian(sphere, lambda x, u: sphere.manifold.projection(x, u), energy, 3)
    group = SE(3)
    twist = lambda x, u: x @ jnp.block([[hat(u[:3]), u[3:, None]], [jnp.zeros((1, 4))]])  # noqa: E731
    yield "SE(3), Cayley", *lagrangian(Midpoint(Cayley(group)), twist, energy, 6)


def by_tape(function, examples):
    """Gradient and Hessian by a tape, the axis of the points last."""
    tape = Tape.trace(function, *examples).second_order(0)
    return lambda data: tape(*data)[1:]


def by_xla(function, examples):
    """The same by XLA."""
    both = jax.jit(jax.vmap(lambda *a: (jax.grad(function)(*a), jax.hessian(function)(*a)), -1, -1))
    return lambda data: jax.block_until_ready(both(*data))


def by_casadi(function, examples):
    """The same graph on CasADi's machine, point after point."""
    tape = Tape.trace(function, *examples)
    value, *by = tape.to_casadi()(*tape.graph.inputs), tape.graph.inputs[0]
    machine = ca.Function(
        "f", tape.graph.inputs, [ca.gradient(value, by[0]), ca.hessian(value, by[0])[0]], {"cse": True}
    )

    def run(data):
        columns = [np.reshape(leaf, (-1, np.shape(leaf)[-1])) for leaf in jax.tree.leaves(data)]
        slope, curvature = (np.array(part) for part in machine(*columns))
        n, points = slope.shape
        return slope, curvature.reshape(n, points, n).transpose(2, 0, 1)

    return run


SIDES = {"tape": by_tape, "XLA": by_xla, "CasADi": by_casadi}


def timed(run, *arguments):
    """Seconds of one call, and what it returned."""
    began = time.perf_counter()
    value = run(*arguments)
    return time.perf_counter() - began, value


def measure(name, function, examples, points, repeats):
    """One record for each number of points."""
    draw = np.random.default_rng(0).standard_normal
    built = {}
    for count in points:
        data = jax.tree.map(lambda a, c=count: np.asarray(a)[..., None] + 0.01 * draw((*np.shape(a), c)), examples)
        cold, values = {}, {}
        for side, build in SIDES.items():
            if side not in built:
                seconds, built[side] = timed(build, function, examples)
                cold[side], values[side] = seconds, None
            seconds, values[side] = timed(built[side], data)
            cold[side] = round(cold.get(side, 0.0) + seconds, 3)
        warm = {side: [] for side in SIDES}
        for _ in range(repeats):
            for side, run in built.items():
                warm[side].append(timed(run, data)[0])
        medians = {side: statistics.median(seconds) for side, seconds in warm.items()}
        scale = max(np.max(np.abs(part)) for part in values["XLA"])
        error = max(
            np.max(np.abs(a - b))
            for side in ("tape", "CasADi")
            for a, b in zip(values[side], values["XLA"], strict=True)
        )
        yield {
            "function": name,
            "points": count,
            "relative difference": float(error / scale),
            "cold, s": cold,
            "warm, microseconds a point": {side: round(1e6 * seconds / count, 3) for side, seconds in medians.items()},
            "XLA over tape": round(medians["XLA"] / medians["tape"], 2),
        }


def main():
    """Print one line for each function and number of points."""
    jax.config.update("jax_enable_x64", True)
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--points", type=int, nargs="+", default=[1, 100, 10_000])
    parser.add_argument("--repeats", type=int, default=11)
    options = parser.parse_args()
    Tape.trace(jnp.sin, np.zeros(1))(np.zeros((1, 1)))  # the machine itself is compiled once on a computer
    for name, function, examples in cases():
        for record in measure(name, function, examples, options.points, options.repeats):
            print(json.dumps(record), flush=True)


if __name__ == "__main__":
    main()
