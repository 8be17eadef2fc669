"""From how many guesses ``solve`` arrives beside IPOPT: the same discrete problems, the same guesses, each side's own
limits.

    python benchmarks/arrival.py [--only PROBLEM ...] [--side retrax ipopt] [--ours 100] [--theirs 3000]

IPOPT is given ``to_casadi`` of the same problem. A guess counts where the solver reports success. One JSON line a
problem: for each side how many of the 24 guesses arrive, by kind; the median of the iterations of those; the best cost,
how many come within a millionth of the best of both sides, and how many costs are found.
"""

import argparse
import json
import statistics
import time

import casadi as ca
import jax

jax.config.update("jax_enable_x64", True)

from arrival_problems import CASES  # noqa: E402  after the precision is set
from retrax.integrators import Solver  # noqa: E402
from retrax.interop import to_casadi  # noqa: E402

QUIET = {"ipopt.print_level": 0, "print_time": False, "ipopt.sb": "yes", "ipopt.tol": 1e-9}
SAME = 1e-6


def retrax(case, limit):
    """A function of a guess: whether it arrives, iterations, cost."""
    solver = Solver(case.problem, case.method, case.steps)

    def solve(guess):
        found = solver.solve(case.start, case.end, case.horizon, guess=guess, throw=False, max_iterations=limit)
        return found.success, found.statistics.iterations, found.cost

    return solve


def ipopt(case, guess, limit):
    """The same of IPOPT."""
    discrete = to_casadi(*case.call, guess=guess)
    solver = ca.nlpsol("solver", "ipopt", discrete.nlp, QUIET | {"ipopt.max_iter": limit})

    def solve(guess):
        found = solver(**{**discrete.arguments, "x0": discrete.initial(guess)})
        stats = solver.stats()
        return stats["success"], stats["iter_count"], float(found["f"])

    return solve


def figures(found, best):
    """Of the outcomes of one side, by kind of guess."""
    arrived = [outcome for outcomes in found.values() for outcome in outcomes if outcome[0]]
    costs = []
    for cost in sorted(cost for _, _, cost in arrived):
        if not costs or cost - costs[-1] > SAME * max(1.0, abs(cost)):
            costs.append(cost)
    return {
        "arrived": len(arrived),
        "by kind": {kind: sum(outcome[0] for outcome in outcomes) for kind, outcomes in found.items()},
        "median iterations": statistics.median([count for _, count, _ in arrived]) if arrived else None,
        "best cost": min(costs, default=None),
        "at the best": sum(cost - best <= SAME * max(1.0, abs(best)) for *_, cost in arrived),
        "optima": len(costs),
    }


def main():
    """Measure what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="+", default=list(CASES))
    parser.add_argument("--side", nargs="+", default=["retrax", "ipopt"], choices=["retrax", "ipopt"])
    parser.add_argument("--ours", type=int, default=100, help="limit of iterations of retrax")
    parser.add_argument("--theirs", type=int, default=3000, help="limit of iterations of IPOPT")
    given = parser.parse_args()
    for name in given.only:
        case = CASES[name]()
        guesses, found = case.guesses(), {}
        began = time.process_time()
        for side in given.side:
            solve = retrax(case, given.ours) if side == "retrax" else ipopt(case, guesses["far"][0], given.theirs)
            found[side] = {kind: [solve(guess) for guess in some] for kind, some in guesses.items()}
        costs = [
            cost for outcomes in found.values() for some in outcomes.values() for success, _, cost in some if success
        ]
        best = min(costs, default=float("inf"))
        row = {side: figures(outcomes, best) for side, outcomes in found.items()}
        print(json.dumps({"problem": name, **row, "seconds": round(time.process_time() - began, 1)}), flush=True)


if __name__ == "__main__":
    main()
