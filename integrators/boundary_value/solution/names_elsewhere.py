"""The names of the attributes of a solution in other libraries."""

from collections.abc import Sequence
from difflib import get_close_matches

# What retrax offers, by the names that CasADi, SciPy, acados, Dymos, pyomo and textbooks use for it.
OFFERED = {
    "states": ("x", "X", "y", "Y", "trajectory", "history", "xs", "path"),
    "controls": ("U", "us", "input", "inputs", "actions", "torques"),
    "costates": ("lam", "lambda_", "lambdas", "adjoint", "adjoints", "P"),
    "multipliers": ("lam_g", "lam_x", "dual", "duals", "v"),
    "times": ("time", "tspan", "ts", "grid", "time_grid"),
    "horizon": ("T", "tf", "t_f", "final_time", "duration", "end_time", "t_final"),
    "steps": ("N", "n_steps", "num_steps"),
    "np.diff(solution.times)": ("h", "dt", "step_size", "step_sizes"),
    "cost": ("J", "fun", "f", "value", "objective", "obj", "cost_value", "objective_value", "optimum"),
    "success": ("converged", "optimal", "solved", "feasible", "ok"),
    "status": ("exitflag", "exit_flag", "return_status", "flag"),
    "checks.error": ("error", "err", "errors"),
    "statistics.iterations": ("iterations", "nit", "niter", "n_iter", "num_iter", "iter", "iter_count", "nfev"),
    "statistics.run_seconds": ("cpu_time", "runtime", "solve_time", "run_time", "elapsed", "seconds", "t_wall_total"),
    "statistics": ("stats", "info"),
    "solution(t)": ("at", "sol", "interpolate", "interp", "sample", "evaluate", "eval"),
}
NAMED_ELSEWHERE = {name: offered for offered, names in OFFERED.items() for name in names}


def attribute_hint(name: str, attributes: Sequence[str]) -> str:
    """A question for the attribute that an unknown name may stand for; empty if there is none.

    A name of another library comes first: names that are merely spelled alike, such as ``dt`` and ``t``, are other
    quantities.
    """
    near = NAMED_ELSEWHERE.get(name) or next(iter(get_close_matches(name, attributes, 1)), "")
    return f"; did you mean {near}?" if near and not name.startswith("_") else ""
