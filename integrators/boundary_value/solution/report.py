"""The printed report of a solution."""

from collections.abc import Iterator

import numpy as np

from ....manifolds.numerics import ambient as vec
from ...reporting.text import plural, table
from .diagnostics import RegularChecks, SingularArc
from .factor_distances import factor_distances, long_turn_words
from .solution_fields import SolutionFields, at_stages

LONGEST_MOMENTUM = 6  # components of a momentum that the report prints; of a longer momentum only its size
REPORT_ROW = "report", "print(error.solution), or solve(..., throw=False), which returns this solution"
EQUAL = 1e-9  # relative: steps that differ by less are of one length


def report_text(solution: SolutionFields) -> str:
    """The report of a solution: the outcome and the effort, then the residuals and the geometry."""
    rows = [*_outcome(solution), *_turns(solution), *_effort(solution)]
    return "\n\n".join(map(table, (rows, [*_residuals(solution), *_geometry(solution)])))


def failure_text(solution: SolutionFields) -> str:
    """The message of the error of a solution without success: result, figures in one row, and the way to the report."""
    checks, missed = solution.checks, {} if solution.singular is None else solution.singular.conditions
    effort = f"cost {solution.cost:.6g} after {solution.statistics.iterations} iterations"
    figures = [f"defect {checks.defect:.1e}", f"{_other_residual(solution)} {checks.stationarity:.1e}"]
    if isinstance(checks, RegularChecks) and (at_stages(solution.multipliers) or solution.node_multipliers):
        figures += [f"inequalities {checks.violation:.1e}"]
    if missed:
        name = max(missed, key=lambda name: missed[name])
        figures += [f"{name} missed by {missed[name]:.1e}"]
    return "\n".join([solution.result, table([("figures", f"{effort}; relative {', '.join(figures)}"), REPORT_ROW])])


def _outcome(solution: SolutionFields) -> Iterator[tuple[str, str]]:
    checks = solution.checks
    yield "result", solution.result
    yield "cost", f"{solution.cost:.12g}{_unit(solution, 'cost')}"
    yield "horizon", f"{solution.times[-1] - solution.times[0]:.9g}{_unit(solution, 'time')}"
    if solution.singular is not None:
        yield from _singular(solution.singular)
        return
    kind = "strict local minimum" if checks.strict_minimum else "not shown to be a strict local minimum"
    yield "second order", f"{kind} of the discrete problem (inertia of the KKT matrix)"
    if isinstance(checks, RegularChecks) and checks.error is not None:
        yield "accuracy", f"relative error of the discretization, summed over the steps: {checks.error:.1e}"
        for name, largest in checks.between.items():
            yield "", f"{name}: {f'violated by up to {largest:.1e}' if largest > 0 else 'holds'} between the stages"
    for name, values in solution.multipliers.items():
        if values.ndim == 1:
            yield "boundary", f"{name}: multipliers {np.array2string(values, precision=8)}"
    if (at_stages(solution.multipliers) or solution.node_multipliers) and isinstance(checks, RegularChecks):
        yield from _inequalities(solution, checks)


def _inequalities(solution: SolutionFields, checks: RegularChecks) -> Iterator[tuple[str, str]]:
    every = {"stages": at_stages(solution.multipliers), "nodes": solution.node_multipliers}
    places = " and ".join(place for place, multipliers in every.items() if multipliers)
    held = (
        f"violated by {checks.violation:.1e}, complementarity {checks.complementarity:.1e} (relative, at the {places})"
    )
    yield "inequalities", held
    for place, multipliers in every.items():
        for name, rows in multipliers.items():
            yield "", f"{name}: {_active(name, rows, place, checks)}"


def _unit(solution: SolutionFields, of: str) -> str:
    """The unit of time or cost, behind a space; empty where it is not known."""
    unit = getattr(solution.quantities, of, "")
    return f" {unit}" if unit else ""


def _active(name: str, rows: np.ndarray, place: str, checks: RegularChecks) -> str:
    """At how many stages or nodes an inequality holds a trajectory, and by how much."""
    count = checks.active.get(name, 0)
    return f"active at {count} of {len(rows)} {place}" + (f", largest multiplier {np.max(rows):.3g}" if count else "")


def _singular(arc: SingularArc) -> Iterator[tuple[str, str]]:
    form = f"its form has a kernel of dimension {arc.kernel}" if arc.kernel else "symplectic"
    gauge = f"; {plural(arc.gauge_controls, 'gauge control')}" if arc.gauge_controls else ""
    yield "problem", f"singular: the extremal lies in P_f, of dimension {arc.dimension}, {form}{gauge}"
    kind = "presymplectic" if arc.presymplectic else "not presymplectic"
    yield "integrator", f"{kind}\n{arc.strategy}"
    yield "second order", arc.second_order
    yield (
        "ends",
        f"{plural(len(arc.conditions), 'condition')}, {plural(arc.independent, 'coordinate')} of "
        "them independent on P_f",
    )
    for name, violation in arc.conditions.items():
        yield "", f"{name} missed by {violation:.1e}"


def _turns(solution: SolutionFields) -> Iterator[tuple[str, str]]:
    """The angles of rotations, and of points of spheres, from the start to the end and in one step."""
    if solution.interpolant is None:
        return
    manifold, states = solution.interpolant.retraction.manifold, solution.states
    ends = factor_distances(manifold, vec.taken(states, 0), vec.taken(states, -1))
    steps = factor_distances(manifold, vec.taken(states, slice(-1)), vec.taken(states, slice(1, None)))
    for (name, whole, is_angle), (_, own, _) in zip(ends, steps, strict=True):
        if not is_angle:
            continue
        largest = float(np.max(own))
        yield (
            "turn",
            f"{name_with_label(name, solution)}: {np.degrees(whole):.4g} degrees from start to end, at most "
            f"{np.degrees(largest):.3g} degrees in one step",
        )
        if words := long_turn_words(largest):
            yield "", words


def _residuals(solution: SolutionFields) -> Iterator[tuple[str, str]]:
    """The residuals of the conditions of an extremal."""
    checks, kind = solution.checks, "KKT residual" if solution.singular is None else "residual"
    yield kind, f"defect {checks.defect:.1e}, {_other_residual(solution)} {checks.stationarity:.1e} (relative)"


def _other_residual(solution: SolutionFields) -> str:
    """The name of the residual of the conditions without the defect."""
    return "stationarity" if solution.singular is None else "equations of P_f"


def _geometry(solution: SolutionFields) -> Iterator[tuple[str, str]]:
    checks = solution.checks
    for equation, violation in checks.violations.items():
        yield "constraint error", f"{name_with_label(equation, solution)}: {violation:.1e}"
    share = checks.hamiltonian_spread / checks.hamiltonian_size if checks.hamiltonian_size else 0.0
    yield (
        "Hamiltonian",
        f"{checks.hamiltonian:.10g}, varies over the stages by {checks.hamiltonian_spread:.1e}, {share:.1e} of its "
        "largest term",
    )
    if solution.success and checks.too_coarse:
        largest = f"varies by {share:.0%} of its largest term"
        yield "", f"{largest}: the discretization is too coarse to be trusted, increase steps"
    for name, momentum in solution.momenta.items() if solution.success else ():
        title = "spatial covector" if name in solution.spatial_costates else "momentum"
        label = name_with_label(name, solution)
        conserved, count = checks.conserved[name], momentum.shape[1]
        constant = f"constant along this extremal: {conserved or 'none'} of {count} components"
        if not conserved:
            yield title, f"{label}: {constant}"
            continue
        first = np.array2string(momentum[0], precision=8) if count <= LONGEST_MOMENTUM else "at the start"
        size, spread = np.max(np.abs(momentum)), checks.momentum_spreads[name]
        # The spread of those that are not constant is no error.
        kept = f", spread over the nodes {spread:.1e}" if conserved == count else ""
        yield title, f"{label}: {first}, size {size:.3g}; {constant}{kept}"


def name_with_label(name: str, solution: SolutionFields) -> str:
    """A name that begins with ``factor k``, with the label of that factor instead."""
    states, quantities = solution.states, solution.quantities
    if not isinstance(states, tuple) or quantities is None:
        return name
    return quantities.labelled(name, len(states))


def _effort(solution: SolutionFields) -> Iterator[tuple[str, str]]:
    statistics, steps = solution.statistics, np.diff(solution.times)
    method = "Newton" if solution.singular is None else "Gauss-Newton"
    least, most = float(steps.min()), float(steps.max())
    length = f"{least:.6g}" if most - least <= EQUAL * most else f"{least:.3g} to {most:.3g}"
    length += _unit(solution, "time")
    if solution.interpolant is not None and len(solution.stage_times):
        stages = plural(len(solution.stage_times) // len(steps), "stage")
        yield "discretization", f"{stages} a step, retraction {solution.interpolant.retraction}"
    yield (
        "iterations",
        f"{plural(statistics.iterations, f'{method} step')} on {plural(len(steps), 'step')} of {length}",
    )
    if solution.singular is not None:
        seconds = statistics.compile_seconds + statistics.run_seconds
        yield (
            "time",
            f"{seconds:.2f} s with compilation, {statistics.compile_seconds:.2f} s of it to classify and to guess",
        )
        return
    yield (
        "time",
        f"{1e3 * statistics.run_seconds:.1f} ms to run; to prepare and check {statistics.compile_seconds:.2f} s",
    )
