"""Which evaluator is chosen: swept through the sizes of what a tape writes out, with the same numbers on both sides."""

from concurrent.futures import ThreadPoolExecutor

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from retrax.compute import automatic as evaluators
from retrax.compute.tape_evaluator import TapeEvaluator
from retrax.integrators import OptimalControlProblem, PresymplecticIntegrator, Solver, SymplecticIntegrator, integrate
from retrax.manifolds import Euclidean, Grassmann, Stiefel, hat
from retrax.retractions import Addition, Cayley, CotangentLift, Exponential, Gauss, Midpoint
from retrax.tape import NotTraceableError, Tape
from retrax.tape.linear import LARGEST_FACTOR
from retrax.tape.trace import LONGEST_LOOP
from scipy.linalg import expm

LINE = Euclidean(1)
MIDPOINT = Midpoint(Addition(LINE))
TRIANGLE = np.eye(LARGEST_FACTOR + 1) + np.tril(np.random.default_rng(0).uniform(-0.3, 0.3, (LARGEST_FACTOR + 1,) * 2))


def solved(rows):
    """The first two unknowns of a triangular system, which no later row changes."""
    matrix = TRIANGLE[:rows, :rows]

    def cost(q):
        x = jax.scipy.linalg.solve_triangular(matrix, jnp.sin(q[0]) * jnp.ones(rows), lower=True)
        return x[:2] @ x[:2]

    return cost


def looped(count):
    """``3 q``, in many factors."""
    return lambda q: jax.lax.fori_loop(0, count, lambda i, x: 3 ** (1 / count) * x, q)[0]


def test_a_solver_runs_on_the_tape_as_far_as_linear_systems_are_written_out():
    costs = []
    for rows in (LARGEST_FACTOR - 1, LARGEST_FACTOR, LARGEST_FACTOR + 1):
        own = solved(rows)
        problem = OptimalControlProblem(LINE, lambda q, u: u, lambda q, u, own=own: u @ u / 2 + own(q), 1)
        solver = Solver(problem, MIDPOINT, 4)
        costs.append(solver.solve(np.zeros(1), np.ones(1), 1.0).cost)
        assert solver.evaluator == ("tape" if rows <= LARGEST_FACTOR else "xla"), (rows, solver.reason)
        assert (f"{rows} rows" in solver.reason) == (rows > LARGEST_FACTOR)
    np.testing.assert_allclose(costs, costs[0], rtol=1e-12)


def test_a_solver_runs_on_the_tape_as_far_as_its_graphs_are_not_too_large(monkeypatch):
    """Swept through the size of the largest graph, with the same solution on both sides."""
    sizes = []
    for name in ("size", "expansion_size"):
        count = vars(Tape)[name].fget
        monkeypatch.setattr(Tape, name, property(lambda t, count=count: sizes.append(count(t)) or sizes[-1]))
    problem = OptimalControlProblem(LINE, lambda q, u: u - jnp.sin(q), lambda q, u: u @ u / 2, 1)

    def solver():
        return Solver(problem, Gauss(2, Addition(LINE)), 4)

    costs = [solver().solve(np.zeros(1), np.ones(1), 1.0).cost]
    largest = max(sizes)
    for most in (largest + 1, largest, largest - 1, 1):
        monkeypatch.setattr(evaluators, "MOST_OPERATIONS", most)
        mine = solver()
        costs.append(mine.solve(np.zeros(1), np.ones(1), 1.0).cost)
        assert mine.evaluator == ("tape" if most >= largest else "xla"), (most, mine.reason)
        assert (f"more than {most}" in mine.reason) == (most < largest)
        assert Solver(problem, MIDPOINT, 4, evaluator="tape").evaluator == "tape"
    np.testing.assert_allclose(costs, costs[0], rtol=1e-12)


def test_steps_run_on_the_tape_as_far_as_loops_are_written_out():
    method, ends = SymplecticIntegrator(CotangentLift(MIDPOINT)), []
    for count in (LONGEST_LOOP - 1, LONGEST_LOOP, LONGEST_LOOP + 1):
        own = looped(count)
        path = integrate(lambda q, p, own=own: p @ p / 2 + own(q), method, (np.zeros(1), np.ones(1)), 0.1, 3)
        ends.append((path.q[-1, 0], path.p[-1, 0]))
        assert path.evaluator.startswith("tape" if count <= LONGEST_LOOP else "XLA"), path.evaluator
        assert (f"{count} iterations" in path.evaluator) == (count > LONGEST_LOOP)
    np.testing.assert_allclose(ends, [(0.3 - 3 * 0.3**2 / 2, 1 - 3 * 0.3)] * 3, rtol=1e-12)


FRAMES = {
    "frames": (Stiefel(3, 2), Exponential, lambda w, x: hat(w) @ x),
    "lines": (Grassmann(3, 1), Exponential, lambda w, x: hat(w) @ x - x @ hat(w)),
    "planes": (Grassmann(4, 2), Cayley, lambda w, x: (a := jnp.pad(hat(w), (0, 1))) @ x - x @ a),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", FRAMES)
def test_frames_and_subspaces_run_on_the_tape_and_have_the_optimum_of_xla(name):
    manifold, family, velocity = FRAMES[name]
    problem = OptimalControlProblem(manifold, lambda x, u: velocity(u, x), lambda x, u: u @ u / 2, 3)
    start = np.asarray(manifold.random_point(jax.random.key(0)))
    turn = np.eye(len(start))
    turn[:3, :3] = expm(np.array(hat(jnp.array([0.5, -0.3, 0.7]))))
    end = turn @ start if isinstance(manifold, Stiefel) else turn @ start @ turn.T
    found = []
    for evaluator in ("automatic", "xla"):
        solver = Solver(problem, Gauss(2, family(manifold)), 4, evaluator)
        assert (solver.evaluator == "tape") == (evaluator == "automatic"), solver.reason
        found.append(solver.solve(start, end, 1.0))
    mine, other = ((s.states, s.costates, s.controls, s.cost) for s in found)
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, atol=1e-10), mine, other)


PLANE, TABLE, CUBES = Euclidean(2), np.linspace(-3.0, 3.0, 25), np.arange(3.0) ** 3
TERMS = {
    "an entry added to": (lambda q: 0.1 * q.at[1].add(q[1]).sum(), "tape"),
    "an entry of zeros": (lambda q: 0.1 * jnp.zeros(3).at[1].multiply(2.0).at[2].add(q[1]).sum(), "tape"),
    "a determinant": (lambda q: jnp.linalg.det(jnp.array([[2 + jnp.cos(q[0]), 0.3], [0.3, 1.5 + q[1] ** 2]])), "tape"),
    "one of three rows": (lambda q: 0.1 * jnp.linalg.det(jnp.outer(q[0] * CUBES, CUBES) + jnp.eye(3)), "tape"),
    "the error function": (lambda q: jax.scipy.special.erf(q[0]), "tape"),
    "a table": (lambda q: jnp.interp(q[0], TABLE, TABLE**2), "tape"),
    "random numbers": (lambda q: 0.1 * jax.random.normal(jax.random.key(0), (2,)) @ q, "xla"),
}  # fmt: skip


@pytest.mark.parametrize("name", TERMS)
@pytest.mark.usual(2)
def test_what_users_write_has_the_same_optimum_on_both(name):
    term, kind = TERMS[name]
    problem = OptimalControlProblem(
        PLANE, lambda q, u: jnp.stack([q[1], u[0] + term(q)]), lambda q, u: u @ u / 2 + q @ q / 2, 1
    )
    solvers = [Solver(problem, Gauss(2, Addition(PLANE)), 6, evaluator=of) for of in ("automatic", "xla")]
    costs = [solver.solve(np.zeros(2), np.array([0.5, 0.0]), 1.0).cost for solver in solvers]
    assert solvers[0].evaluator == kind, solvers[0].reason
    assert costs[0] == pytest.approx(costs[1], rel=1e-11)


@pytest.mark.parametrize("evaluator", ["automatic", "tape", "xla"])
@pytest.mark.usual(1)
def test_controls_are_found_where_the_dynamics_reads_a_table(evaluator):
    """The control of a double integrator is ``p_2``, by the implicit function theorem, whatever the drift."""
    problem = OptimalControlProblem(
        PLANE, lambda q, u: jnp.stack([q[1], u[0] + jnp.interp(q[0], TABLE, TABLE**2)]), lambda q, u: u @ u / 2, 1
    )
    method = PresymplecticIntegrator(Gauss(1, Addition(PLANE)))
    path = integrate(problem, method, (jnp.zeros(2), jnp.array([0.1, 0.2])), 0.1, 4, evaluator=evaluator)
    np.testing.assert_allclose(np.ravel(path.controls), (path.p[1:, 1] + path.p[:-1, 1]) / 2, rtol=1e-9)


@pytest.mark.parametrize(
    "factor", [jnp.linalg.cholesky, lambda a: jnp.linalg.qr(a)[1], lambda a: jnp.linalg.solve(a, a[0])]
)
def test_no_larger_matrix_is_factorised_on_the_tape(factor):
    for rows in (LARGEST_FACTOR + 1, 2 * LARGEST_FACTOR):
        with pytest.raises(NotTraceableError, match=f"of a matrix of {rows} rows, where at most {LARGEST_FACTOR}"):
            Tape.trace(lambda x, n=rows: factor(jnp.eye(n) + x[0]), np.ones(1))


def together(x, y, none):
    """A product and a sum with what is empty."""
    return jnp.outer(x, y) + jnp.sum(none), jnp.sum(x) * y


@pytest.mark.parametrize("points", [1, 3, 100, 20_000])
def test_threads_share_a_tape_and_keep_what_they_found(points):
    """Few points and many, with shared arguments, empty ones and ones that are not in order of memory."""
    tape = TapeEvaluator().values(together, 2, 3, 0)

    def found(k):
        x, y = k + np.arange(2.0 * points).reshape(2, points).T[None], np.full((1, 1, 3), 1.0 + k)
        product, total = tape.at(2, x, y, np.zeros((1, 1, 0)))
        again = tape.at(2, x + 1, y, np.zeros((1, 1, 0)))
        again[0][:] = np.nan
        return np.array_equal(product, x[..., None] * y[..., None, :]) and np.array_equal(
            total, x.sum(axis=-1, keepdims=True) * y
        )

    with ThreadPoolExecutor(4) as pool:
        assert all(pool.map(found, range(40 if points > 1000 else 400)))
    assert tape.at(2, np.zeros((1, 0, 2)), np.zeros((1, 1, 3)), np.zeros((1, 1, 0)))[0].shape == (1, 0, 2, 3)
