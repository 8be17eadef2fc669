"""Single precision: everything works to about six digits, and a warning says so, once."""

import subprocess
import sys

import pytest

pytestmark = pytest.mark.slow

SCRIPT = """
import warnings
import jax, numpy as np
from retrax.integrators import OptimalControlProblem, SymplecticIntegrator, integrate, solve
from retrax.manifolds import SO, Sphere, hat
from retrax.retractions import CotangentLift, Exponential, Midpoint, Projection

assert not jax.config.jax_enable_x64
jax.config.update("jax_disable_most_optimizations", True)
with warnings.catch_warnings(record=True) as caught:
    warnings.simplefilter("always")
    problem = OptimalControlProblem(SO(3), lambda q, u: q @ hat(u), lambda q, u: u @ u / 2, 3)
    quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    discretization = Midpoint(Exponential(SO(3)))
    costs = [solve(problem, np.eye(3), quarter, 1.0, method=discretization, steps=3).cost for _ in range(2)]

    lift = CotangentLift(Midpoint(Projection(Sphere(2))))
    start = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.6, 0.3])
    path = integrate(lambda q, p: p @ p / 2 + q[2], SymplecticIntegrator(lift), start, 0.1, 50)
from retrax.integrators import integrate_many
from retrax.manifolds import Euclidean, NotOnManifoldError
line = SymplecticIntegrator(CotangentLift(Midpoint(Exponential(Euclidean(1)))))
for run, shape in ((integrate, 1), (integrate_many, (2, 1))):  # infinite in single precision
    for start in ((np.full(shape, 1e200), np.ones(shape)), (np.ones(shape), np.full(shape, 1e200))):
        try:
            with np.errstate(over="ignore"):
                run(lambda q, p: p @ p / 2, line, start, 0.1, 2)
            raise SystemExit(f"{start} is taken")
        except NotOnManifoldError as error:
            assert "NaN or infinite" in str(error), error
lift_z = path.q[:, 0] * path.p[:, 1] - path.q[:, 1] * path.p[:, 0]
print(path.q.dtype, costs[0], float(np.ptp(lift_z)), float(np.ptp(np.linalg.norm(path.q, axis=1))))
print(*[str(w.message) for w in caught if "precision" in str(w.message)], sep="\\n")
print(len(caught))
"""


@pytest.fixture(scope="module")
def output() -> list[str]:
    done = subprocess.run([sys.executable, "-c", SCRIPT], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


def test_numbers_are_right_to_single_precision(output):
    dtype, cost, momentum, radius = output[0].split()
    assert dtype == "float32"
    assert float(cost) == pytest.approx((3.141592653589793 / 2) ** 2 / 2, rel=1e-5)
    assert float(momentum) < 1e-5
    assert float(radius) < 1e-5


def test_one_warning_says_what_to_expect_and_what_to_do(output):
    assert len(output) == 3
    assert "single precision" in output[1]
    assert 'jax.config.update("jax_enable_x64", True)' in output[1]
    assert output[2] == "1"
