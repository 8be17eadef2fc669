"""Singular arcs between bounds: their order, their feedback and Kelley's condition, from the classification along
them."""

from types import SimpleNamespace
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array
from retrax import problems
from retrax.integrators import Guess, OptimalControlProblem, find_singular_arcs, solve
from retrax.integrators.boundary_value.audit.singular_arcs import _nearest
from retrax.manifolds import Euclidean, InvalidInputError, Sphere
from retrax.retractions import Addition, Gauss, default_retraction

LINE, PLANE, SPHERE = Euclidean(1), Euclidean(2), Sphere(2)
BOUNDS = {"control_bounds": (-1.0, 1.0)}


def at_rest(dimension: int, stages: int) -> Guess:
    return Guess(np.zeros((stages, dimension)), np.zeros((stages, 1)))


@pytest.mark.slow
def test_an_arc_between_bangs_has_order_one_and_its_feedback():
    """``q^2`` is driven to zero by a bounded rate and stays there while there is time: ``u = 0`` on ``q = p = 0``."""
    idle = {"far": lambda q, u: q - 10}  # holds nowhere
    for width, constraints in ((0.0, None), (1.0, None), (1.0, idle)):
        given = {**BOUNDS, "constraints": constraints}
        problem = OptimalControlProblem(LINE, lambda q, u: u, lambda q, u: q @ q, 1, **given)
        found = solve(
            problem, np.ones(1), np.ones(1), 2.0 + width, method=Gauss(2, Addition(LINE)), steps=24, accuracy=1e-9
        )
        arcs = find_singular_arcs(problem, found)
        assert len(arcs) == (width > 0)
        for arc in arcs:
            assert (arc.begin, arc.end) == pytest.approx((1.0, 1.0 + width), abs=1e-6)
            assert (arc.controls, arc.order, arc.classification.dimension) == ((0,), 1, 0)
            assert arc.feedback_error < 1e-5
            assert "strict generalised Legendre-Clebsch condition met (largest eigenvalue -2)" in arc.second_order
            assert "u[0] singular, of order 1; P_f of dimension 0" in str(arc)


@pytest.mark.parametrize(
    ("order", "condition"), [(1, "Legendre-Clebsch condition"), (2, "Kelley's condition of order 2")]
)
@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.slow
def test_the_condition_of_kelley_tells_a_minimum_from_none(order, condition, sign):
    """At rest at the minimum, or at the maximum, of ``q^2`` under a chain of integrators: equally stationary."""
    manifold = Euclidean(order)

    def chain(q: Array, u: Array) -> Array:
        return jnp.concatenate([q[1:], u])

    problem = OptimalControlProblem(manifold, chain, lambda q, u: sign * q[0] ** 2, 1, **BOUNDS)
    rest, guess = np.zeros(order), at_rest(order, 20)
    found = solve(problem, rest, rest, 1.0, method=Gauss(2, Addition(manifold)), steps=10, guess=guess, throw=False)
    assert found.success
    (arc,) = find_singular_arcs(problem, found)
    assert arc.order == order
    assert f"{condition} {'met' if sign > 0 else 'fails'} (largest eigenvalue {-2 * sign}" in arc.second_order


@pytest.mark.slow
def test_the_arc_of_a_rocket():
    """Goddard's: full thrust, a singular arc of order one, none."""
    known = problems.get("goddard")
    found = known.solve()
    (arc,) = find_singular_arcs(known.problem, found)
    assert (arc.order, arc.classification.dimension) == (1, 4)
    assert arc.feedback_error < 2e-3
    assert "strict generalised Legendre-Clebsch condition met" in arc.second_order


@pytest.mark.slow
def test_an_arc_on_the_sphere_beside_a_control_at_its_bound():
    """To the equator and along it, which the first control leaves alone, while the second one keeps its price low."""
    up, across = jnp.array([0.0, 0.0, 1.0]), jnp.array([1.0, 0.0, 0.0])

    def turning(q: Array, u: Array, spin: Array) -> Array:
        return jnp.cross(spin * up + u[0] * across, q)

    def price(q: Array, u: Array, spin: Array) -> Array:
        return q[2] ** 2 + u[1]

    problem = OptimalControlProblem(SPHERE, turning, price, 2, **BOUNDS)
    start, method = np.array([np.cos(0.4), 0.0, np.sin(0.4)]), Gauss(4, default_retraction(SPHERE))
    found = solve(problem, start, None, 2.0, method=method, steps=20, parameters=1.0, accuracy=1e-9)
    (arc,) = find_singular_arcs(problem, found)
    assert (arc.controls, arc.order) == ((0,), 1)
    # Where a rotation about (-1, 0, 1) takes the start to the equator, and the integral until there.
    assert arc.begin == pytest.approx(0.8153418309513, abs=1e-6)
    assert found.cost + 2.0 == pytest.approx(0.0637851127474143, abs=1e-11)
    assert arc.feedback_error < 1e-4
    assert "strict generalised Legendre-Clebsch condition met" in arc.second_order


def test_arcs_that_a_cost_or_a_constraint_determines_are_none():
    method = Gauss(2, Addition(LINE))
    curved = OptimalControlProblem(LINE, lambda q, u: u, lambda q, u: q @ q + u @ u, 1, **BOUNDS)
    assert not find_singular_arcs(curved, solve(curved, np.ones(1), np.ones(1), 3.0, method=method, steps=20))
    floor = {"floor": lambda q, u: 0.5 - q}
    held = OptimalControlProblem(LINE, lambda q, u: u, lambda q, u: q @ q, 1, constraints=floor, **BOUNDS)
    assert not find_singular_arcs(held, solve(held, np.ones(1), np.ones(1), 3.0, method=method, steps=20))


@pytest.mark.parametrize(
    ("options", "given", "words"),
    [
        (BOUNDS, 3, r"find_singular_arcs takes a Solution, got 3; try what solve returns"),
        ({}, None, r"a problem without control_bounds"),
        (
            {**BOUNDS, "time_dependent": True},
            None,
            r"functions of \(q, u\), got a problem with time_dependent=True; try the time as a state",
        ),
    ],
)
def test_what_has_no_such_arcs_is_named(options, given, words):
    timed = "time_dependent" in options
    functions: Any = (lambda q, u, t: u, lambda q, u, t: u @ u) if timed else (lambda q, u: u, lambda q, u: u @ u)
    problem = OptimalControlProblem(LINE, *functions, 1, **options)
    solution = given or solve(problem, np.zeros(1), np.full(1, 0.5), 1.0, method=Gauss(1, Addition(LINE)), steps=4)
    with pytest.raises(InvalidInputError, match=words):
        find_singular_arcs(problem, solution)


@pytest.mark.parametrize("place", [-1.0, 0.2, 0.49, 0.51, 1.0, 7.0])
def test_an_arc_is_on_the_piece_whose_equations_it_violates_least(place):
    """Of the planes ``x = 0``, ``x = 1`` and one without points near."""
    strata = [SimpleNamespace(equations=lambda z, c=c: z[0] - c) for c in (0.0, 1.0, np.nan)]
    found: Any = SimpleNamespace(strata=strata, choose=lambda i: i)
    assert _nearest(found, (np.full((3, 1), place), np.zeros((3, 1)))) == (place > 0.5)
