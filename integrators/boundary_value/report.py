"""The printed report of a solution."""

from .solution import Solution


def report_text(solution: Solution) -> str:
    """What a user checks, a line each."""
    checks, statistics = solution.checks, solution.statistics
    kind = "strict local minimum" if checks.strict_minimum else "not a strict local minimum"
    size = abs(checks.hamiltonian)
    lines = [
        ("result", solution.result),
        ("cost", f"{solution.cost:.12g}"),
        ("second order", f"{kind} of the discrete problem (inertia of the KKT matrix)"),
        ("KKT residual", f"gap {checks.gap:.1e}, stationarity {checks.stationarity:.1e} (relative)"),
        ("constraint error", f"{checks.constraint:.1e} at the nodes"),
        (
            "Hamiltonian",
            f"{checks.hamiltonian:.10g}, spread over the stages {checks.hamiltonian_spread:.1e} of size {size:.1e}",
        ),
    ]
    for name, (largest, spread) in checks.momenta.items():
        lines.append((f"momentum, {name}", f"size {largest:.8g}, spread over the nodes {spread:.1e}"))
    compiled = f"{statistics.compile_seconds:.2f} s" if statistics.compile_seconds else "none"
    lines.append(
        (
            "iterations",
            f"{statistics.iterations} Newton steps, {solution.steps} steps of {solution.times[1] - solution.times[0]:.6g}",
        )
    )
    lines.append(("time", f"{1e3 * statistics.run_seconds:.1f} ms to run; compilation: {compiled}"))
    width = max(len(name) for name, _ in lines)
    return "\n".join(f"{name:<{width}}  {text}" for name, text in lines)
