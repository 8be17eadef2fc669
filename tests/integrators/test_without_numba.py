"""Where Numba is not available, as for a new Python: XLA and Python solve, and one warning says so."""

import json
import os
import subprocess
import sys
import warnings

import jax.numpy as jnp
import numpy as np
import pytest
from retrax.integrators import OptimalControlProblem, Solver, SymplecticIntegrator, integrate
from retrax.manifolds import Euclidean, Sphere
from retrax.retractions import CotangentLift, Exponential, Gauss, Midpoint
from retrax.tape import Tape

BALL = Sphere(2)
NORTH, EAST, LOW = np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0]), np.array([0.6, 0.0, -0.8])


def turned(q, u):
    """A sphere that turns about its first axis, and about the other two as the controls say."""
    return jnp.cross(jnp.array([0.3, u[0], u[1]]), q)


def problem(**limits):
    return OptimalControlProblem(BALL, turned, lambda q, u: u @ u / 2 - q[1] / 4, Euclidean(2), **limits)


def solved():
    """Costs of problems with and without limits by methods with one point and with several, of one and of a batch; a
    sensitivity; the end of a trajectory; a tape. And the evaluators that computed them."""
    method = SymplecticIntegrator(CotangentLift(Midpoint(Exponential(BALL))))
    path = integrate(lambda q, p: p @ p / 2 + q[2], method, (NORTH, EAST), 0.1, 5)
    free, held = (
        problem(),
        problem(control_bounds=([-2.0] * 2, [0.9] * 2), constraints={"east": lambda q, u: q[1] - 0.2}),
    )
    numbers, evaluators = [], set()
    for of, method in ((free, Midpoint(Exponential(BALL))), (held, Gauss(2, Exponential(BALL)))):
        solver = Solver(of, method, 6)
        found = solver.solve(NORTH, EAST, 2.0)
        numbers += [found.cost, *solver.solve_many(NORTH, np.stack([EAST, LOW]), 2.0).cost]
        evaluators.add(solver.evaluator)
    numbers.append(solver.sensitivity(found).horizon.cost)
    tape = Tape.trace(lambda x: jnp.sin(x) * x, 0.0)
    numbers += [*np.asarray(path.q[-1]), *tape(np.array([0.5, 1.0]))]
    return {"numbers": [*map(float, numbers)], "evaluators": [*evaluators, path.evaluator]}


@pytest.mark.slow
@pytest.mark.parametrize(("way", "advice"), [("missing", "pip install numba"), ("NUMBA_DISABLE_JIT", "without it")])
def test_all_is_found_with_one_warning(way, advice):
    command, environment = [sys.executable, __file__, way], {**os.environ, "JAX_ENABLE_X64": "1"}
    environment |= {} if way == "missing" else {way: "1"}
    child = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert child.returncode == 0, child.stderr
    expected, found = solved(), json.loads(child.stdout.splitlines()[-1])
    np.testing.assert_allclose(found["numbers"], expected["numbers"], rtol=1e-9)
    assert all(name.startswith("tape") for name in expected["evaluators"]), expected
    assert found["evaluators"][0] == "xla"
    assert found["evaluators"][1].startswith("tape")
    (warning,) = found["warnings"]
    assert "Numba is not available" in warning
    assert advice in warning


if __name__ == "__main__":
    if sys.argv[1] == "missing":
        sys.modules |= {"numba": None, "llvmlite": None}
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        everything = solved()
    print(json.dumps({**everything, "warnings": [str(w.message) for w in caught]}))
