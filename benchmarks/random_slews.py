"""How many random rest-to-rest slews ``solve`` converges on from its default guess, with and without limits of the
torque.

    python benchmarks/random_slews.py [--slews 1000] [--steps 40] [--ipopt 50]

Attitudes are uniform on SO(3), inertias obey the triangle inequalities, horizons are log-uniform from 10 to 10 000 s.
The limits are 60 % of the largest torque of the slew without them, an axis each: less than 2/3, which a turn about one
axis needs, so that some slews are impossible. IPOPT solves the first ones, and those that failed: ``to_casadi`` of the
same problem, the same guess. A cost above IPOPT's by a millionth, or none, counts as dearer. One JSON line each, times
in ms of one slew.
"""

import argparse
import json
import statistics
import time

import casadi as ca
import jax
import jax.numpy as jnp
import numpy as np
from scipy.spatial.transform import Rotation

jax.config.update("jax_enable_x64", True)

from retrax.integrators import OptimalControlProblem, Solver  # noqa: E402  after the precision is set
from retrax.interop import to_casadi  # noqa: E402
from retrax.manifolds import SO, Euclidean, hat  # noqa: E402
from retrax.retractions import Cayley, Midpoint  # noqa: E402

BODY = SO(3) * Euclidean(3)
QUIET = {
    "ipopt.print_level": 0,
    "print_time": False,
    "ipopt.sb": "yes",
    "ipopt.tol": 1e-9,
    "ipopt.bound_relax_factor": 0.0,
}
SHARE = 0.6  # of the largest torque without limits
SAME = 1e-6


def turning(q, u, given):
    """Attitude and body rate under the torque ``given["torque"] u``."""
    attitude, rate = q
    inertia = given["inertia"]
    return attitude @ hat(rate), (given["torque"] * u - jnp.cross(rate, inertia * rate)) / inertia


def effort(q, u, given):
    torque = given["torque"] * u
    return torque @ torque / 2


def drawn(rng):
    """Inertia in kg m^2, target and horizon in s of a slew."""
    masses = np.exp(rng.uniform(np.log(0.05), 0.0, 3))  # of a distribution along the axes: moments are sums of two
    inertia = np.exp(rng.uniform(np.log(1.0), np.log(1e4))) * (np.sum(masses) - masses)
    return inertia, Rotation.random(rng=rng).as_matrix(), float(np.exp(rng.uniform(np.log(10.0), np.log(1e4))))


def solved(solver, end, horizon, given):
    """The solution from the default guess, and its milliseconds."""
    began = time.perf_counter()
    found = solver.solve((np.eye(3), np.zeros(3)), (end, np.zeros(3)), horizon, parameters=given, throw=False)
    return found, 1e3 * (time.perf_counter() - began)


def ipopt_cost(problem, method, steps, end, horizon, given):
    """The cost at which IPOPT arrives, and its milliseconds; infinite where it does not."""
    ends = (np.eye(3), np.zeros(3)), (end, np.zeros(3))
    discrete = to_casadi(problem, method, *ends, horizon, steps, parameters=given)
    solver = ca.nlpsol("solver", "ipopt", discrete.nlp, QUIET)
    began = time.perf_counter()
    found = solver(**discrete.arguments)
    spent = 1e3 * (time.perf_counter() - began)
    return (float(found["f"]) if solver.stats()["success"] else np.inf), spent


def figures(outcomes, dearer, theirs):
    """Of the slews of one kind."""
    right = [found for found, _ in outcomes if found.success]
    return {
        "slews": len(outcomes),
        "converged": len(right),
        "strict minima": sum(bool(found.checks.strict_minimum) for found in right),
        "not finite": sum(not bool(np.isfinite(found.cost)) for found, _ in outcomes),
        "median iterations": statistics.median(found.statistics.iterations for found in right),
        "most iterations": max(found.statistics.iterations for found in right),
        "median ms": round(statistics.median(spent for _, spent in outcomes), 2),
        "IPOPT": len(theirs),
        "IPOPT converged": sum(bool(np.isfinite(cost)) for cost, _ in theirs),
        "IPOPT median ms": round(statistics.median(spent for _, spent in theirs), 2) if theirs else None,
        "dearer than IPOPT": len(dearer),
        "dearest": dearer[:10],
        "failed": [[index, str(found.result)[:90]] for index, (found, _) in enumerate(outcomes) if not found.success][
            :10
        ],
    }


def main():
    """Measure both kinds."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--slews", type=int, default=1000)
    parser.add_argument("--steps", type=int, default=40)
    parser.add_argument("--ipopt", type=int, default=50)
    asked = parser.parse_args()
    rng, method = np.random.default_rng(0), Midpoint(Cayley(BODY))
    slews = [drawn(rng) for _ in range(asked.slews)]
    peaks = np.ones(asked.slews)
    for kind, bounds in (("without limits", None), ("limited", (-SHARE, SHARE))):
        problem = OptimalControlProblem(BODY, turning, effort, Euclidean(3), control_bounds=bounds)
        solver, outcomes, theirs, dearer = Solver(problem, method, asked.steps), [], [], []
        for index, (slew, peak) in enumerate(zip(slews, peaks, strict=True)):
            _, end, horizon = slew
            given = _given(slew, peak)
            outcomes.append(solved(solver, end, horizon, given))
            if index < asked.ipopt or not outcomes[-1][0].success:
                theirs.append(ipopt_cost(problem, method, asked.steps, end, horizon, given))
                found, least = outcomes[-1][0], theirs[-1][0]
                if np.isfinite(least) and not (found.success and found.cost <= least * (1 + SAME)):
                    dearer.append([index, found.cost if found.success else None, least])
        print(json.dumps({"kind": kind, "steps": asked.steps, **figures(outcomes, dearer, theirs)}), flush=True)
        if bounds is None:
            peaks = np.array([np.max(np.abs(found.controls)) for found, _ in outcomes])


def _given(slew, torque):
    return {"inertia": slew[0], "torque": np.array(torque)}


if __name__ == "__main__":
    main()
