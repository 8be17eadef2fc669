"""Retractions, inverses and tangent projections in batches, beside pymanopt, geomstats, SciPy and jaxlie.

    python benchmarks/retractions.py [--batches 1 100 10000] [--seconds 0.5] [--cases S2 SO3]

Medians of one run, calls taken in turns, everything warm, double precision. Beside the time of each call stands its
accuracy: of retraction and inverse the largest error of the round trip ``R^-1(x, R(x, v)) = v``. A library is given its
arrays in its own format; a call that took over 50 ms is left out of larger batches. One JSON line for each manifold,
operation and batch size.
"""

import argparse
import json
import statistics
import time

import jax
import numpy as np
from manifold_peers import OPERATIONS, peers
from retrax.manifolds import SO, SPD, Sphere, Stiefel
from retrax.retractions import QR, Cayley, Exponential, Polar, Projection, SPDSecondOrder

jax.config.update("jax_enable_x64", True)

SLOW = 0.05  # seconds of a call above which it is left out of larger batches

CASES = {
    "S2": {"exponential": Exponential(Sphere(2)), "projection": Projection(Sphere(2))},
    "SO3": {"exponential": Exponential(SO(3)), "Cayley": Cayley(SO(3))},
    "SO8": {"exponential": Exponential(SO(8)), "Cayley": Cayley(SO(8))},
    "St(20,5)": {"QR": QR(Stiefel(20, 5)), "polar": Polar(Stiefel(20, 5)), "Cayley": Cayley(Stiefel(20, 5))},
    "SPD6": {"second order": SPDSecondOrder(SPD(6)), "exponential": Exponential(SPD(6))},
}


def ours(retraction):
    """The functions of a retraction, compiled and batched, with the wait for their values."""
    functions = (retraction, retraction.inverse, retraction.manifold.projection)
    batched = [jax.jit(jax.vmap(function)) for function in functions]
    waiting = [lambda *arguments, f=f: jax.block_until_ready(f(*arguments)) for f in batched]
    return dict(zip(OPERATIONS, waiting, strict=True))


def draw(manifold, count):
    """Points, ambient vectors, and tangent vectors at most 0.1 long."""
    first, second = jax.random.split(jax.random.key(0))
    x = jax.jit(jax.vmap(manifold.random_point))(jax.random.split(first, count))
    a = jax.random.normal(second, x.shape)
    v = jax.jit(jax.vmap(manifold.projection))(x, a)
    length = jax.numpy.sqrt(jax.numpy.sum(v.reshape(count, -1) ** 2, axis=1))
    return x, a, v * (0.1 / length).reshape(-1, *(1,) * (v.ndim - 1))


def medians(calls, seconds):
    """Median seconds of each call, taken in turns until each has had this much time."""
    taken = {name: [] for name in calls}
    for call in calls.values():
        call()
    while any(sum(times) < seconds for times in taken.values()):
        for name, call in calls.items():
            if sum(taken[name]) < seconds:
                start = time.perf_counter()
                call()
                taken[name].append(time.perf_counter() - start)
    return {name: statistics.median(times) for name, times in taken.items()}


def waiting_call(function, arguments):
    """A call without arguments that ends when its value is there."""
    return lambda: jax.block_until_ready(function(*arguments))


def compare(name, count, seconds, slow):
    """One JSON record for each operation on a batch of this size; the calls in ``slow`` are left out, new ones join
    it."""
    mine = {f"retrax {kind}": (kind, ours(retraction)) for kind, retraction in CASES[name].items()}
    manifold = next(iter(CASES[name].values())).manifold
    x, a, v = draw(manifold, count)
    numpy_arrays = tuple(map(np.asarray, (x, a, v)))
    calls, errors = {operation: {} for operation in OPERATIONS}, {}
    for library, (kind, functions) in (mine | peers(name)).items():
        x_, a_, v_ = (x, a, v) if library.startswith(("retrax", "jaxlie")) else numpy_arrays
        arguments = {"retraction": (x_, v_), "projection": (x_, a_)}
        label = library if library.startswith("retrax") else f"{library} ({kind})"
        moved = ("retraction", label) not in slow
        if moved:
            arguments["inverse"] = (x_, functions["retraction"](x_, v_))
        for operation, function in functions.items():
            if function is not None and operation in arguments and (operation, label) not in slow:
                calls[operation][label] = waiting_call(function, arguments[operation])
        if moved and label in calls["inverse"]:
            errors[label] = float(
                np.max(np.abs(np.asarray(functions["inverse"](*arguments["inverse"])) - np.asarray(v)))
            )
    for operation in OPERATIONS:
        timed = medians(calls[operation], seconds)
        slow |= {(operation, label) for label, value in timed.items() if value > SLOW}
        row = {"manifold": name, "operation": operation, "batch": count}
        row["microseconds"] = {label: round(1e6 * value, 1) for label, value in timed.items()}
        row["fastest"] = min(timed, key=timed.__getitem__)
        if operation != "projection":
            row["round trip error"] = {label: float(f"{errors[label]:.1e}") for label in timed if label in errors}
        yield row


def main():
    """Print one JSON line for each manifold, batch size and operation."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--batches", type=int, nargs="+", default=[1, 100, 10_000])
    parser.add_argument("--seconds", type=float, default=0.5, help="time spent on each call")
    parser.add_argument("--cases", nargs="+", default=list(CASES), choices=list(CASES))
    options = parser.parse_args()
    for name in options.cases:
        slow = set()
        for count in options.batches:
            for row in compare(name, count, options.seconds, slow):
                print(json.dumps(row), flush=True)


if __name__ == "__main__":
    main()
