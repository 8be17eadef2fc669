"""What ``integrate`` and the integrators refuse, and the words they use."""

import jax.numpy as jnp
import numpy as np
import pytest
from retrax.integrators import OptimalControlProblem, PresymplecticIntegrator, SymplecticIntegrator, integrate
from retrax.manifolds import Euclidean, InvalidInputError, NotOnManifoldError
from retrax.retractions import CotangentLift, Midpoint, Projection

from tests.support.numerics import norm

from .problems import ELLIPSOID, KINEMATIC, SPHERE, half_square, pendulum_energy

LIFT = CotangentLift(Midpoint(Projection(SPHERE)))
SYMPLECTIC, PRESYMPLECTIC = SymplecticIntegrator(LIFT), PresymplecticIntegrator(LIFT)
Q, P = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.6, 0.3])
ON_SPHERE = OptimalControlProblem(SPHERE, lambda q, u: SPHERE.projection(q, u), half_square, 3)


def run(system=pendulum_energy, integrator=SYMPLECTIC, start=(Q, P), step_size=0.1, steps=2, **options):
    return integrate(system, integrator, start, step_size, steps, **options)


@pytest.mark.parametrize("kind", [SymplecticIntegrator, PresymplecticIntegrator])
@pytest.mark.parametrize("given", [None, Projection(SPHERE), Midpoint(Projection(SPHERE)), "midpoint"])
def test_an_integrator_takes_a_cotangent_lift(kind, given):
    with pytest.raises(
        InvalidInputError, match=r"(?s)takes a cotangent lift or a collocation method, got .*try CotangentLift"
    ):
        kind(given)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"integrator": LIFT}, r"takes an integrator.*got CotangentLift.*try SymplecticIntegrator"),
        ({"step_size": 0.0}, r"step_size must be a finite number other than 0, got 0.0"),
        ({"step_size": float("nan")}, r"step_size must be a finite number other than 0, got nan"),
        ({"step_size": [0.1]}, r"step_size must be a finite number other than 0, got \[0.1\]"),
        ({"step_size": None}, r"step_size must be a finite number other than 0, got None"),
        ({"step_size": "0.1"}, r"step_size must be a finite number other than 0, got '0.1'"),
        ({"steps": 0}, r"steps must be a whole number of at least 1, got 0"),
        ({"steps": 2.0}, r"steps must be a whole number of at least 1, got 2.0"),
        ({"save_every": 0}, r"save_every must be a whole number of at least 1, got 0"),
        ({"steps": 5, "save_every": 2}, r"steps must be a multiple of save_every, got 5 and 2"),
        ({"system": None}, r"a Hamiltonian H\(q, p\), got None"),
        ({"system": ON_SPHERE}, r"a Hamiltonian H\(q, p\), got OptimalControlProblem"),
        ({"system": lambda q, p: p}, r"Hamiltonian must return a scalar, got .*\(3,\)"),
        ({"system": pendulum_energy, "integrator": PRESYMPLECTIC}, r"an OptimalControlProblem, got <function"),
        ({"start": Q}, r"start must be .*pair"),
        ({"start": (Q,)}, r"start must be .*pair"),
        ({"start": (Q, P, P)}, r"start must be .*pair"),
    ],
)
def test_arguments_of_the_wrong_kind_are_named(options, words):
    with pytest.raises(InvalidInputError, match=rf"(?s){words}"):
        run(**options)


@pytest.mark.parametrize(
    ("start", "words"),
    [
        ((2 * Q, P), r"start: not on Sphere.* is 3, expected at most"),
        ((Q[:2], P), r"start: a point of Sphere.*shape \(3,\), got \(2,\)"),
        ((Q, P[:2]), r"start: a covector of Sphere.*shape \(3,\), got \(2,\)"),
        ((Q, np.nan * P), r"start: a covector of Sphere.*NaN"),
        ((np.nan * Q, P), r"start: a point of Sphere.*NaN"),
        ((Q, None), r"start: a covector of Sphere.*structure array\[3\], got None"),
        (([1.0, 0.0, 0.0], P), r"start: a point of Sphere.*structure array\[3\], got \[float, float, float\]"),
    ],
)
def test_a_start_that_is_no_point_of_the_cotangent_bundle_is_described(start, words):
    with pytest.raises(NotOnManifoldError, match=words):
        run(start=start)


@pytest.mark.parametrize(
    "problem",
    [KINEMATIC, OptimalControlProblem(Euclidean(3), lambda q, u: u, half_square, 3), ON_SPHERE],
    ids=["rotations", "space", "sphere"],
)
def test_a_problem_on_another_manifold_than_the_integrators_is_refused(problem):
    """Also where points look alike: the ellipsoid and the sphere have one shape and one dimension."""
    other = ELLIPSOID if problem is ON_SPHERE else SPHERE
    integrator = PresymplecticIntegrator(CotangentLift(Midpoint(Projection(other))))
    with pytest.raises(InvalidInputError, match=r"(?s)acts on .*the problem on"):
        run(problem, integrator, (jnp.asarray(Q), jnp.asarray(P)))


def test_dynamics_that_leave_the_tangent_space_are_refused():
    sloppy = OptimalControlProblem(SPHERE, lambda q, u: u + q, half_square, 3)
    with pytest.raises(NotOnManifoldError, match="leaves the tangent space"):
        run(sloppy, PRESYMPLECTIC)


def test_an_energy_that_is_no_number_is_an_error_in_words():
    with pytest.raises(InvalidInputError, match=r"the Hamiltonian is not finite at the start, at q = .* value is nan"):
        run(lambda q, p: p @ p / 2 + jnp.sqrt(-q[0]))


@pytest.mark.parametrize("kind", [int, np.float32, list], ids=["whole numbers", "single precision", "list pair"])
def test_points_in_another_number_format_are_taken(kind):
    q, p = Q, np.array([0.0, 1.0, 0.0])
    start = [q, p] if kind is list else (q.astype(kind), p.astype(kind))
    assert norm(run(start=start).q - run(start=(q, p)).q) < 1e-15


def test_whole_numbers_of_every_kind_count_steps():
    assert norm(run(steps=np.int64(2), save_every=np.int32(1)).q - run().q) == 0.0
