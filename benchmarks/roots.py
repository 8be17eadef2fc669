"""Every Newton and least-squares iteration of the library beside optimistix, and small linear solves beside lineax.

    python benchmarks/roots.py [--cases "inverse, sphere"] [--seconds 0.5] [--compilations 3]

Each case is an equation of the library (``root_equations.py``), solved by what solves it there and by the solvers of
optimistix that are apt, from the same starts. The error is the largest entry of the Newton step that is left, in units
of the unknowns. A start fails where a solver claims no root; a claim is wrong where the error is over 1e-8. Solvers of
optimistix run at the loosest tolerance at which their median error is at most ten times ours, or 1e-12, and none of
their claims is wrong. Other roots than the one that is asked for are counted where that is known.

Warm times are medians of calls in turns, of one start and of a batch; functions are traced, lowered and compiled anew
each time, in turns, with the library's options of XLA on both sides. Of a solver of the library that is not one
compiled function the first call stands for that. Whole trajectories and linear solves follow. One JSON line a case and
solver.
"""

import argparse
import json
import statistics
import time
from collections import Counter
from functools import partial

import jax
import jax.numpy as jnp
import lineax
import numpy as np
import optimistix
from retrax.compute import automatic, jit_cache
from retrax.integrators import Flow
from retrax.manifolds.numerics.chord_newton import row_sizes
from retrax.tracing import Tracing, resume_tracing
from root_equations import CASES, COUNT, SYSTEMS, pose_step, states

jax.config.update("jax_enable_x64", True)


OURS = "retrax"
TOLERANCES = 1e-2, 1e-4, 1e-6, 1e-8, 1e-10, 1e-12
RIGHT, WORSE, FINE = 1e-8, 10.0, 1e-12  # errors: of a root, over ours, and what is as good as ours
CUTOFF = 1e-11  # of singular values, as in the library's least squares
COUNTED = 20  # starts from which iterations are counted
STEPS, STEP = 200, 0.1  # of a trajectory
SOLVERS = {
    "Newton": lambda tol: optimistix.Newton(tol, tol),
    "Chord": lambda tol: optimistix.Chord(tol, tol),
    "Dogleg": lambda tol: optimistix.Dogleg(tol, tol, linear_solver=lineax.SVD(CUTOFF)),
    "GaussNewton": lambda tol: optimistix.GaussNewton(tol, tol, linear_solver=lineax.SVD(CUTOFF)),
    "LevenbergMarquardt": lambda tol: optimistix.LevenbergMarquardt(tol, tol),
    "BestSoFar": lambda tol: optimistix.BestSoFarRootFinder(optimistix.Newton(tol, tol)),
}


def unmarked(c):
    """Unknowns as they are."""
    return c


def find(case, name, mark, data, tolerance):
    """A root at some data, and whether it is claimed."""
    posed = case.pose(data, mark)
    if name == OURS:
        return posed.ours()
    solve = optimistix.root_find if case.can_be_met else optimistix.least_squares
    found = solve(lambda c, _: posed.residual(c), SOLVERS[name](tolerance), posed.start, throw=False)
    return found.value, found.result == optimistix.RESULTS.successful


def taken(data, which):
    """Some starts, or one."""
    return jax.tree.map(lambda leaf: jnp.asarray(leaf)[which], data)


def forgotten():
    """Drop all that is traced or compiled."""
    jax.clear_caches()
    jit_cache._compiled.clear()
    automatic._tapes.clear()


def prepared(function, arguments):
    """A compiled function, and the seconds to trace, to lower and to compile it."""
    forgotten()
    marks = [time.perf_counter()]
    traced = jax.jit(function).trace(*arguments)
    marks.append(time.perf_counter())
    lowered = traced.lower()
    marks.append(time.perf_counter())
    compiled = lowered.compile(jit_cache.compiler_options())
    marks.append(time.perf_counter())
    return compiled, np.diff(marks)


def seconds_of(calls, seconds):
    """Median seconds of each call, taken in turns until all have had this much time, three calls at least."""
    taken = {name: [] for name in calls}
    for call in calls.values():
        jax.block_until_ready(call())
    while any(sum(times) < seconds or len(times) < 3 for times in taken.values()):
        for name, call in calls.items():
            if sum(taken[name]) < seconds or len(taken[name]) < 3:
                began = time.perf_counter()
                jax.block_until_ready(call())
                taken[name].append(time.perf_counter() - began)
    return {name: statistics.median(times) for name, times in taken.items()}


def errors(case, data, roots=None):
    """At each root, by default zero, the largest entry of the Newton step that is left; infinite where the equations do
    not hold though they can."""

    def left(data, c):
        posed = case.pose(data, unmarked)
        c = jnp.zeros_like(posed.start) if roots is None else c
        values, jacobian = posed.residual(c), jax.jacfwd(posed.residual)(c)
        finite = jnp.all(jnp.isfinite(jacobian)) & jnp.all(jnp.isfinite(values))
        step = jnp.linalg.pinv(jnp.where(finite, jacobian, 0.0), rtol=CUTOFF) @ values
        met = finite & ((jnp.max(jnp.abs(values)) <= 1e-6) | (not case.can_be_met))
        return jnp.where(met, jnp.max(jnp.abs(step)), jnp.inf)

    given = jnp.zeros(len(jax.tree.leaves(data)[0])) if roots is None else roots
    return np.asarray(jax.jit(jax.vmap(left))(jax.tree.map(jnp.asarray, data), given))


def typical(error, claimed):
    """Median over what is claimed."""
    return float(np.median(error[claimed])) if claimed.any() else np.inf


def verdict(case, data, roots, claimed):
    """Median error, starts without a root, wrong claims, and roots other than the one that is asked for."""
    claimed, error = np.asarray(claimed), errors(case, data, roots)
    right = claimed & (error <= RIGHT)
    row = {"error": typical(error, claimed), "failed": int(np.sum(~claimed)), "wrong": int(np.sum(claimed & ~right))}
    if case.wanted is not None:
        apart = np.max(np.abs(np.asarray(roots - jax.vmap(case.wanted)(data))), axis=1)
        row["another"] = int(np.sum(right & ~(apart <= 1e-6)))
    return row


def iterations(case, name, tolerance):
    """Medians over some starts of the Jacobians, and of the other evaluations of the equations."""
    seen, found = Counter(), []

    @jax.custom_jvp
    def mark(c):
        jax.debug.callback(lambda: seen.update(["values"]))
        return c

    @mark.defjvp
    def _(primals, tangents):
        jax.debug.callback(lambda: seen.update(["Jacobians"]))
        return primals[0], tangents[0]

    run = jax.jit(partial(find, case, name, mark))
    for i in range(min(COUNTED, len(jax.tree.leaves(case.starts["easy"])[0]))):
        seen.clear()
        jax.block_until_ready(run(taken(case.starts["easy"], i), tolerance))
        jax.effects_barrier()
        found.append((seen["Jacobians"], seen["values"]))
    jacobians, values = map(statistics.median, zip(*found, strict=True))
    return {"Jacobians": jacobians, "values": values}


def in_a_reading(function):
    """The function, of which calls that follow find what one has traced."""
    reading = Tracing()

    def call(data):
        with resume_tracing(reading):
            return function(data)

    return call


class Host:
    """A solver of the library that takes a batch as it is; in one reading, as where the library calls it."""

    def __init__(self, case, compilations):
        self.case, self.tolerance, first = case, None, []
        data = {1: taken(case.starts["easy"], slice(0, 1)), COUNT: case.starts["easy"]}
        data = {count: jax.tree.map(np.asarray, starts) for count, starts in data.items()}
        for _ in range(compilations):
            forgotten()
            began = time.perf_counter()
            host = in_a_reading(case.host())
            host(data[1])
            first.append(time.perf_counter() - began)
        self.compilation = {"first call": round(statistics.median(first), 3)}
        self.calls = {count: partial(host, starts) for count, starts in data.items()}
        self.verdicts = {}
        for kind, starts in case.starts.items():
            there, claimed = host(jax.tree.map(np.asarray, starts))
            self.verdicts[kind] = verdict(case._replace(wanted=None), there, None, claimed)
        self.iterations = {}


class Compiled:
    """A solver as a compiled function, at the loosest tolerance that reaches an error."""

    def __init__(self, case, name, wanted):
        self.solve, easy = partial(find, case, name, unmarked), case.starts["easy"]
        self.arguments = taken(easy, 0)
        batch, self.batch_seconds = prepared(jax.vmap(self.solve, (0, None)), (easy, 0.0))
        for self.tolerance in TOLERANCES if name != OURS else TOLERANCES[:1]:
            self.verdicts = {
                kind: verdict(case, starts, *batch(starts, self.tolerance)) for kind, starts in case.starts.items()
            }
            wrong = sum(found["wrong"] for found in self.verdicts.values())
            if self.verdicts["easy"]["error"] <= wanted and not wrong:
                break
        self.iterations = iterations(case, name, self.tolerance)
        self.calls = {1: None, COUNT: partial(batch, easy, self.tolerance)}
        self.parts = []

    def compile(self):
        """Compile the function of one start once more."""
        single, parts = prepared(self.solve, (self.arguments, 0.0))
        self.parts.append(parts)
        self.calls[1] = partial(single, self.arguments, self.tolerance)

    @property
    def compilation(self):
        """Seconds, medians."""
        parts = np.median(self.parts, axis=0)
        return dict(zip(("trace", "lower", "compile"), parts.round(3).tolist(), strict=True)) | {
            "all": round(float(np.sum(parts)), 3),
            "batch": round(float(np.sum(self.batch_seconds)), 3),
        }


def compare(name, seconds, compilations):
    """One record for each solver of a case."""
    case = CASES[name]()
    ours = Host(case, compilations) if case.host else Compiled(case, OURS, np.inf)
    wanted = max(WORSE * ours.verdicts["easy"]["error"], FINE)
    sides = {OURS: ours} | {peer: Compiled(case, peer, wanted) for peer in case.peers}
    for _ in range(compilations):
        for side in sides.values():
            if isinstance(side, Compiled):
                side.compile()
    counts = (1, COUNT) if len(jax.tree.leaves(case.starts["easy"])[0]) == COUNT else (1,)
    warm = {count: seconds_of({peer: side.calls[count] for peer, side in sides.items()}, seconds) for count in counts}
    for peer, side in sides.items():
        row = {"case": name, "solver": f"{OURS}: {case.solved_by}" if peer == OURS else peer}
        row |= {"unknowns": size(case), "tolerance": side.tolerance if peer != OURS else None, **side.verdicts}
        row["iterations"], row["compilation, s"] = side.iterations, side.compilation
        for count, times in warm.items():
            row[f"microseconds, {count}"] = round(1e6 * times[peer], 1)
            row[f"over ours, {count}"] = round(times[peer] / times[OURS], 2)
        yield row


def size(case):
    """Number of unknowns."""
    return jax.eval_shape(lambda data: case.pose(data, unmarked).start, taken(case.starts["easy"], 0)).size


def trajectories(name, seconds, compilations):
    """Whole trajectories: ours by the compiled core, and loops under XLA around its own solver and those of
    optimistix."""
    system, integrator = SYSTEMS[name]
    starts = states(integrator)
    flow, first_call = time_first_calls(system, integrator, taken(starts, 0), compilations)
    calls = {
        1: {"compiled core": lambda: flow.integrate(taken(starts, 0), STEP, STEPS, save_every=STEPS)},
        COUNT: {"compiled core": lambda: flow.integrate_many(starts, STEP, STEPS, save_every=STEPS)},
    }
    ends = flow.integrate_many(starts, STEP, STEPS, save_every=STEPS)
    rows = {"compiled core": {"first call, s": first_call}}
    for solver in (OURS, "Newton", "Chord"):
        run = partial(steps_under_xla, system, integrator, solver)
        batch, _ = prepared(jax.vmap(run, (0, None)), (starts, 0.0))
        for tolerance in TOLERANCES if solver != OURS else TOLERANCES[:1]:
            q, p = batch(starts, tolerance)
            apart = max(float(jnp.max(jnp.abs(q - ends.q[:, -1]))), float(jnp.max(jnp.abs(p - ends.p[:, -1]))))
            if apart <= 1e-9:
                break
        single = [prepared(run, (taken(starts, 0), 0.0)) for _ in range(compilations)]
        rows[solver] = {"tolerance": None if solver == OURS else tolerance, "apart": apart}
        rows[solver]["first call, s"] = round(float(np.median([np.sum(parts) for _, parts in single])), 3)
        calls[1][solver] = partial(single[-1][0], taken(starts, 0), tolerance)
        calls[COUNT][solver] = partial(batch, starts, tolerance)
    warm = {count: seconds_of(sides, seconds) for count, sides in calls.items()}
    for solver, row in rows.items():
        label = {"compiled core": f"{OURS}: compiled core", OURS: f"{OURS}: find_root"}.get(solver, solver)
        row = {"trajectory": name, "solver": label, "tolerance": None, "apart": 0.0} | row
        for count, times in warm.items():
            row[f"microseconds a step, {count}"] = round(1e6 * times[solver] / STEPS / count, 3)
            row[f"over ours, {count}"] = round(times[solver] / times["compiled core"], 2)
        yield row


def time_first_calls(system, integrator, start, compilations):
    """A flow on the compiled core, and the median time of its first call, in seconds."""
    first = []
    for _ in range(compilations):
        forgotten()
        began = time.perf_counter()
        flow = Flow(system, integrator)
        flow.integrate(start, STEP, STEPS, save_every=STEPS)
        first.append(time.perf_counter() - began)
    return flow, round(statistics.median(first), 3)


def steps_under_xla(system, integrator, solver, start, tolerance):
    """The end of a trajectory whose steps are solved in a loop under XLA."""

    def step(z, _):
        posed, equations = pose_step(system, integrator, (*z, jnp.asarray(STEP)), unmarked)
        if solver == OURS:
            c, _ = posed.ours()
        else:
            method = SOLVERS[solver](tolerance)
            c = optimistix.root_find(lambda c, _: posed.residual(c), method, posed.start, throw=False).value
        q, p, _ = equations.end(equations.sizes * c)
        q = integrator.manifold.restore(q)
        return (q, integrator.manifold.projection(q, p)), None

    return jax.lax.scan(step, start, length=STEPS)[0]


def in_units(a, b):
    """As Newton's method of the library solves; it does so again and again with one inverse."""
    rows = row_sizes(a)
    return (jnp.linalg.inv(a / rows[:, None]) / rows) @ b


def by_lineax(method, a, b):
    """A dense solve that is told nothing of the matrix."""
    return lineax.linear_solve(lineax.MatrixLinearOperator(a), b, method, throw=False).value


LINEAR = {
    "retrax: jnp.linalg.solve": jnp.linalg.solve,
    "retrax: inverse, rows in units": in_units,
    "lineax LU": partial(by_lineax, lineax.LU()),
    "lineax QR": partial(by_lineax, lineax.QR()),
    "lineax SVD": partial(by_lineax, lineax.SVD()),
    "lineax Auto": partial(by_lineax, lineax.AutoLinearSolver(well_posed=None)),
}


def linear_solves(n, seconds, compilations):
    """One record for each solver of a batch of dense systems of ``n`` equations."""
    rng = np.random.default_rng(0)
    a, x = jnp.asarray(rng.standard_normal((COUNT, n, n))), jnp.asarray(rng.standard_normal((COUNT, n)))
    b = jnp.einsum("kij,kj->ki", a, x)
    calls, rows = {1: {}, COUNT: {}}, {}
    for name, solve in LINEAR.items():
        single = [prepared(solve, (a[0], b[0])) for _ in range(compilations)]
        batch, _ = prepared(jax.vmap(solve), (a, b))
        left = jnp.max(jnp.abs(jnp.einsum("kij,kj->ki", a, batch(a, b)) - b), axis=1)
        rows[name] = {"residual": float(jnp.median(left / jnp.max(jnp.abs(b), axis=1)))}
        rows[name]["compilation, s"] = round(float(np.median([np.sum(parts) for _, parts in single])), 4)
        calls[1][name], calls[COUNT][name] = partial(single[-1][0], a[0], b[0]), partial(batch, a, b)
    warm = {count: seconds_of(sides, seconds) for count, sides in calls.items()}
    for name, row in rows.items():
        for count, times in warm.items():
            row[f"microseconds, {count}"] = round(1e6 * times[name], 1)
            row[f"over ours, {count}"] = round(times[name] / times["retrax: jnp.linalg.solve"], 2)
        yield {"linear equations": n, "solver": name} | row


def main():
    """Print one JSON line for each case and solver."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--cases", nargs="*", default=list(CASES), choices=list(CASES))
    parser.add_argument("--trajectories", nargs="*", default=list(SYSTEMS), choices=list(SYSTEMS))
    parser.add_argument("--sizes", type=int, nargs="*", default=[3, 6, 15], help="of linear systems")
    parser.add_argument("--seconds", type=float, default=0.5, help="time spent on each call")
    parser.add_argument("--compilations", type=int, default=3)
    options = parser.parse_args()
    limits = options.seconds, options.compilations
    for function, names in (
        (compare, options.cases),
        (trajectories, options.trajectories),
        (linear_solves, options.sizes),
    ):
        for name in names:
            for row in function(name, *limits):
                print(json.dumps(row), flush=True)


if __name__ == "__main__":
    main()
