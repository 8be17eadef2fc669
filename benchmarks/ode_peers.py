"""Peers: two mechanical systems on manifolds, integrated in their embedding with SciPy and diffrax.

Free rigid body with principal moments ``J = diag(1, 2, 3)``; attitude ``R`` in SO(3) and body momentum ``mu``, 12
numbers, ``R`` by rows:

    R' = R hat(w),        mu' = mu x w,        w = J^-1 mu,        R(0) = I,  mu(0) = (1, -0.5, 0.7)

Spherical pendulum of unit mass, length and gravity, ``H = |p|^2 / 2 + q_z`` on T*S^2, 6 numbers:

    q' = p,        p' = -(e_z - q_z q) - |p|^2 q,        q(0) = (1, 0, 0),  p(0) = (0, 0.6, 0.3)

Off the manifold this field repels: ``a = |q|^2 - 1`` obeys ``a'' = -2 (|p|^2 - q_z) a``, whose solutions grow by some
six decades in a time of 100. ``PENDULUM_MULTIPLIER`` is the same system with the multiplier that holds off the manifold
too, ``p' = -e_z + (q_z - |p|^2) q / |q|^2``, for which ``a'' = 0``.

Every quantity is dimensionless and times are in seconds of wall clock. The error of a run is the Euclidean distance, in
the embedding, of its final state from the reference, that of the worst member in a batch. A method runs at the loosest
tolerance ``rtol = atol`` whose error meets the target. Each method gets the field in the layout it is fastest with:
Python floats for SciPy, one array for a single diffrax run, one array per component for a batch.
"""

import contextlib
import functools
import math
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
from scipy.integrate import solve_ivp

jax.config.update("jax_enable_x64", True)

BATCH = 1024
SPREAD = 0.1  # scatter of the momenta over a batch, relative to the norm of the nominal one
DIFFRAX_SOLVERS = {"dopri5": diffrax.Dopri5, "dopri8": diffrax.Dopri8, "tsit5": diffrax.Tsit5}
MAX_STEPS = 20_000  # of a diffrax run; a run that needs more counts as one that misses its target
SCIPY_LEAST_RTOL = 100 * np.finfo(float).eps  # solve_ivp takes no tighter one


class TargetMissedError(ValueError):
    """No tolerance gives an error as small as the target."""


@dataclass(frozen=True, eq=False)
class Problem:
    """An equation ``x' = f(x)`` on states of ``n`` numbers that stay on a manifold.

    ``components(*x)``: the field, from ``n`` numbers or arrays of one shape to as many; ``vector(x)``: the same from
    one JAX array to another. ``constraint_error(x)``: the largest defect of the manifold's equations, and
    ``energy(x)``, for states ``(n, ...)``. ``scattered``: the positions of the momenta that a batch scatters.
    ``twin``: a problem with the same flow on the manifold and a better one off it, for the reference.
    """

    name: str
    components: Callable
    vector: Callable
    constraint_error: Callable
    energy: Callable
    initial: tuple
    scattered: slice
    twin: "Problem | None" = None

    def initial_states(self, batch=None, seed=0):
        """The initial state (n,), or ``batch`` of them (batch, n): the first the nominal one, the others scattered."""
        nominal = np.array(self.initial, dtype=float)
        if batch is None:
            return nominal
        states = np.tile(nominal, (batch, 1))
        noise = np.random.default_rng(seed).normal(size=states[1:, self.scattered].shape)
        states[1:, self.scattered] += SPREAD * np.linalg.norm(nominal[self.scattered]) * noise
        return states


def _rigid_components(a, b, c, d, e, f, g, h, i, m1, m2, m3):
    w1, w2, w3 = m1, m2 / 2, m3 / 3
    first = b * w3 - c * w2, c * w1 - a * w3, a * w2 - b * w1
    second = e * w3 - f * w2, f * w1 - d * w3, d * w2 - e * w1
    third = h * w3 - i * w2, i * w1 - g * w3, g * w2 - h * w1
    return *first, *second, *third, m2 * w3 - m3 * w2, m3 * w1 - m1 * w3, m1 * w2 - m2 * w1


def _rigid_vector(x):
    attitude, mu = x[:9].reshape(3, 3), x[9:]
    w = mu / jnp.array([1.0, 2.0, 3.0])
    return jnp.concatenate([jnp.cross(attitude, w[None]).ravel(), jnp.cross(mu, w)])


def _rigid_constraint_error(x):
    attitude = x[:9].reshape(3, 3, *x.shape[1:])
    gram = np.einsum("ki...,kj...->ij...", attitude, attitude)
    return np.abs(np.moveaxis(gram, (0, 1), (-2, -1)) - np.eye(3)).max(axis=(-2, -1))


def _rigid_energy(x):
    return (x[9] ** 2 + x[10] ** 2 / 2 + x[11] ** 2 / 3) / 2


def _pendulum_components(x, y, z, px, py, pz):
    tension = z - (px * px + py * py + pz * pz)
    return px, py, pz, tension * x, tension * y, tension * z - 1


def _pendulum_vector(x):
    q, p = x[:3], x[3:]
    return jnp.concatenate([p, (q[2] - p @ p) * q - jnp.array([0.0, 0.0, 1.0])])


def _multiplier_components(x, y, z, px, py, pz):
    tension = (z - (px * px + py * py + pz * pz)) / (x * x + y * y + z * z)
    return px, py, pz, tension * x, tension * y, tension * z - 1


def _multiplier_vector(x):
    q, p = x[:3], x[3:]
    return jnp.concatenate([p, (q[2] - p @ p) / (q @ q) * q - jnp.array([0.0, 0.0, 1.0])])


def _pendulum_constraint_error(x):
    q, p = x[:3], x[3:]
    return np.maximum(np.abs((q * q).sum(axis=0) - 1), np.abs((q * p).sum(axis=0)))


def _pendulum_energy(x):
    return (x[3:] ** 2).sum(axis=0) / 2 + x[2]


RIGID_BODY = Problem(
    name="free rigid body",
    components=_rigid_components,
    vector=_rigid_vector,
    constraint_error=_rigid_constraint_error,
    energy=_rigid_energy,
    initial=(1, 0, 0, 0, 1, 0, 0, 0, 1, 1.0, -0.5, 0.7),
    scattered=slice(9, 12),
)
# The momentum is scattered in the tangent plane at q = (1, 0, 0).
PENDULUM_MULTIPLIER = Problem(
    name="spherical pendulum, multiplier",
    components=_multiplier_components,
    vector=_multiplier_vector,
    constraint_error=_pendulum_constraint_error,
    energy=_pendulum_energy,
    initial=(1.0, 0.0, 0.0, 0.0, 0.6, 0.3),
    scattered=slice(4, 6),
)
PENDULUM = replace(
    PENDULUM_MULTIPLIER,
    name="spherical pendulum",
    components=_pendulum_components,
    vector=_pendulum_vector,
    twin=PENDULUM_MULTIPLIER,
)
PROBLEMS = (RIGID_BODY, PENDULUM, PENDULUM_MULTIPLIER)


def _midpoint_sums(field, x, step, parts):
    """The modified midpoint rule over ``step`` in an even number of ``parts``; its error is even in ``1 / parts``."""
    h = step / parts
    before, now = x, x + h * field(x)
    for _ in range(parts - 1):
        before, now = now, before + 2 * h * field(now)
    return now


def _extrapolated_step(field, x, step, columns):
    """Extrapolate the rule in ``parts = 2, 4, ..., 2 columns`` to zero: a step of order ``2 columns``."""
    parts = [2 * (j + 1) for j in range(columns)]
    row = []
    for j, n in enumerate(parts):
        previous, row = row, [_midpoint_sums(field, x, step, n)]
        for k in range(j):
            ratio = np.longdouble(n * n) / (parts[j - k - 1] ** 2)
            row.append(row[k] + (row[k] - previous[k]) / (ratio - 1))
    return row[-1]


@functools.cache
def reference(problem, horizon, batch=None, step=0.0625, columns=6):
    """The true final state (n,), or (batch, n) for ``initial_states(batch)``, in double precision.

    Extrapolation of order 12 in extended precision; within 1e-13 to a horizon of 200 where ``numpy.longdouble`` has a
    mantissa of 64 bits.
    """
    if problem.twin is not None:
        return reference(problem.twin, horizon, batch, step, columns)

    def field(x):
        return np.stack(problem.components(*x))

    steps = math.ceil(horizon / step)
    h = np.longdouble(horizon) / steps
    x = problem.initial_states(batch).T.astype(np.longdouble)
    for _ in range(steps):
        x = _extrapolated_step(field, x, h, columns)
    return x.T.astype(float)


@dataclass(frozen=True)
class PeerRun:
    """One method at the tolerance that meets a target: medians over the repeats, worst member of a batch.

    ``seconds``, ``fastest_seconds``: median and least wall time of a warm run; ``cold_seconds``: that of the first run,
    with compilation, at the tolerance ``target_error``. ``steps`` are the accepted ones, ``evaluations`` the calls of
    the field. ``constraint_error`` and ``energy_error`` are at the final time.
    """

    method: str
    seconds: float
    fastest_seconds: float
    cold_seconds: float
    steps: int
    evaluations: int
    error: float
    constraint_error: float
    energy_error: float
    tolerance: float


def loosest_tolerance(error_at, target, resolution=0.05):
    """The loosest tolerance with ``error_at(tolerance) <= target``, to ``resolution`` decades, by bisection.

    A decade that contains it is found first, going up or down from the target itself; raises TargetMissedError where
    there is none down to 1e-15.
    """
    low = math.log10(target)
    if error_at(10**low) <= target:
        while error_at(10 ** (low + 1)) <= target:
            low += 1
    else:
        low -= 1
        while not error_at(10**low) <= target:
            low -= 1
            if low < -15:
                raise TargetMissedError(f"no tolerance down to 1e-15 gives an error of {target:.1e}")
    high = low + 1
    while high - low > resolution:
        middle = (low + high) / 2
        low, high = (middle, high) if error_at(10**middle) <= target else (low, middle)
    return 10**low


def timed(run, repeats):
    """Wall times in seconds of ``repeats`` calls of ``run``."""
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        run()
        times.append(time.perf_counter() - start)
    return times


def final_error(problem, horizon, final):
    """The distance of a final state (n,), or the largest of those of a batch (batch, n), from the reference."""
    true = reference(problem, horizon, None if final.ndim == 1 else len(final))
    return float(np.linalg.norm(final - true, axis=-1).max())


def _peer_run(method, problem, horizon, tolerance, times, initial, final, counts):
    cold, warm = times
    energy_error = np.abs(problem.energy(final.T) - problem.energy(initial.T)).max()
    return PeerRun(
        method=method,
        seconds=statistics.median(warm),
        fastest_seconds=min(warm),
        cold_seconds=cold,
        steps=counts[0],
        evaluations=counts[1],
        error=final_error(problem, horizon, final),
        constraint_error=float(problem.constraint_error(final.T).max()),
        energy_error=float(energy_error),
        tolerance=tolerance,
    )


def scipy_dop853(problem, horizon, target_error, repeats=7):
    """``solve_ivp`` with DOP853, from ``problem.initial`` over ``[0, horizon]``, at ``target_error``."""
    initial = problem.initial_states()

    def field(_, x):
        return problem.components(*x.tolist())

    def run(tolerance):
        rtol = max(tolerance, SCIPY_LEAST_RTOL)
        return solve_ivp(field, (0.0, horizon), initial, method="DOP853", rtol=rtol, atol=tolerance)

    def error_at(tolerance):
        with np.errstate(over="ignore", invalid="ignore"):
            found = run(tolerance)
        return final_error(problem, horizon, found.y[:, -1]) if found.success else math.inf

    (cold,) = timed(lambda: run(target_error), 1)
    tolerance = loosest_tolerance(error_at, target_error)
    times = timed(lambda: run(tolerance), repeats)
    found = run(tolerance)
    return _peer_run(
        "scipy dop853",
        problem,
        horizon,
        tolerance,
        (cold, times),
        initial,
        found.y[:, -1],
        (found.t.size - 1, found.nfev),
    )


def diffrax_function(problem, horizon, solver, batch):
    """The compiled ``(initial states, tolerance) -> (final states, accepted steps, attempted steps)``."""
    split, join = (tuple, jnp.stack) if batch else (lambda x: x, lambda x: x)
    field = (lambda t, x, _: problem.components(*x)) if batch else (lambda t, x, _: problem.vector(x))

    def solve(initial, tolerance):
        found = diffrax.diffeqsolve(
            diffrax.ODETerm(field),
            solver,
            t0=0.0,
            t1=horizon,
            dt0=None,
            y0=split(initial),
            stepsize_controller=diffrax.PIDController(rtol=tolerance, atol=tolerance),
            saveat=diffrax.SaveAt(t1=True),
            adjoint=diffrax.ForwardMode(),
            max_steps=MAX_STEPS,
            throw=False,
        )
        final = join(jax.tree.map(lambda a: a[0], found.ys))
        return final, found.stats["num_accepted_steps"], found.stats["num_steps"]

    return jax.jit(jax.vmap(solve, in_axes=(0, None)) if batch else solve)


def diffrax_solve(problem, horizon, target_error, batch=None, solver="dopri8", repeats=7):
    """``diffeqsolve`` in double precision, compiled, with an error below ``target_error``.

    ``solver`` is a key of ``DIFFRAX_SOLVERS``; ``batch`` is None for the nominal trajectory, or how many to map over.
    """
    method = DIFFRAX_SOLVERS[solver]()
    function = diffrax_function(problem, horizon, method, batch)
    initial = jnp.asarray(problem.initial_states(batch))

    def run(tolerance):
        return jax.block_until_ready(function(initial, tolerance))

    (cold,) = timed(lambda: run(target_error), 1)
    tolerance = loosest_tolerance(lambda t: final_error(problem, horizon, np.asarray(run(t)[0])), target_error)
    times = timed(lambda: run(tolerance), repeats)
    final, accepted, attempted = map(np.asarray, run(tolerance))
    # The last stage of a step is the first of the next one; one call more at the start.
    evaluations = int(attempted.max()) * (method.tableau.num_stages - 1) + 1
    name = f"diffrax {solver}" + (f" x {batch}" if batch else "")
    counts = int(accepted.max()), evaluations
    return _peer_run(name, problem, horizon, tolerance, (cold, times), np.asarray(initial), final, counts)


def peer_runs(problem, horizon, target_error):
    """Every peer on one problem, those that reach the target."""
    calls = [functools.partial(scipy_dop853, problem, horizon, target_error)]
    for batch in (None, BATCH):
        for solver in ("dopri5", "dopri8"):
            calls.append(functools.partial(diffrax_solve, problem, horizon, target_error, batch, solver))
    for call in calls:
        with contextlib.suppress(TargetMissedError):
            yield call()


def main(horizon=20.0):
    """Print one row for each problem, target error and method."""
    for problem in PROBLEMS:
        print(f"{problem.name}, horizon {horizon:g}")
        titles = f"{'method':<24}{'error':>9}{'steps':>7}{'calls':>8}{'warm ms':>10}{'least ms':>10}"
        print(f"{titles}{'cold s':>8}{'constraint':>12}{'energy':>9}")
        for target in (1e-4, 1e-7, 1e-10):
            for run in peer_runs(problem, horizon, target):
                row = f"{run.method:<24}{run.error:>9.1e}{run.steps:>7}{run.evaluations:>8}{1e3 * run.seconds:>10.2f}"
                row += f"{1e3 * run.fastest_seconds:>10.2f}{run.cold_seconds:>8.2f}"
                print(f"{row}{run.constraint_error:>12.1e}{run.energy_error:>9.1e}", flush=True)


if __name__ == "__main__":
    main()
