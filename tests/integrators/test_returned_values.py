"""What functions return: converted where that is harmless, refused in words where it is not."""

from functools import partial
from warnings import catch_warnings, simplefilter

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from retrax.integrators import (
    OptimalControlProblem,
    PresymplecticIntegrator,
    Solver,
    SymplecticIntegrator,
    classify,
    integrate,
    solve,
)
from retrax.integrators.reporting.result_sentences import warn_of_coarse_values
from retrax.manifolds import Euclidean, InvalidInputError, NotOnManifoldError
from retrax.retractions import Addition, CotangentLift, Midpoint

from tests.integrators.test_asked_for import AHEAD, MIDPOINT, PLANE, REST, effort
from tests.integrators.test_kinks import cart
from tests.support.numerics import norm

LIFT = CotangentLift(MIDPOINT)
SYMPLECTIC, PRESYMPLECTIC = SymplecticIntegrator(LIFT), PresymplecticIntegrator(LIFT)
LINE = Euclidean(1)

NUMBERS = {
    "nothing": (lambda x: None, "must return a real number, got nothing; did it forget to return"),
    "complex": (lambda x: x @ x + 0j, r"must return a real number, got a complex one; try jnp\.real"),
    "truth": (lambda x: x[0] > 0, r"must return a real number, got bool values; try jnp\.where"),
    "a vector": (lambda x: x[:1], r"must return a scalar, got an array of shape \(1,\); sum it"),
    "a list": (lambda x: [x @ x], r"must return a scalar, got an array of shape \(1,\)"),
    "a dictionary": (lambda x: {"cost": x @ x}, "must return a real number, got {'cost'"),
    "a word": (lambda x: "cheap", "must return a real number, got 'cheap'"),
}


@pytest.mark.parametrize("kind", NUMBERS)
def test_what_is_no_real_number_is_named_wherever_it_is_asked_for(kind):
    number, words = NUMBERS[kind]
    running = OptimalControlProblem(PLANE, cart, lambda q, u: number(u), 1)
    final = OptimalControlProblem(PLANE, cart, effort, 1, terminal_cost=number)
    for run in (
        lambda: solve(running, REST, AHEAD, 1.0, method=MIDPOINT, steps=4),
        lambda: classify(running),
        lambda: integrate(running, PRESYMPLECTIC, (REST, AHEAD), 0.1, 2),
    ):
        with pytest.raises(InvalidInputError, match=f"^running_cost {words}"):
            run()
    with pytest.raises(InvalidInputError, match=f"^terminal_cost {words}"):
        solve(final, REST, None, 1.0, method=MIDPOINT, steps=4)
    with pytest.raises(InvalidInputError, match=f"^the Hamiltonian {words}"):
        integrate(lambda q, p: number(p), SYMPLECTIC, (REST, AHEAD), 0.1, 2)


@pytest.mark.parametrize(
    ("dynamics", "words"),
    [
        (lambda q, u: cart(q, u) + 0j, r"dynamics, a tangent vector of R\^2, has real entries, got complex ones"),
        (lambda q, u: cart(q, u) > 0, r"dynamics, .* has numbers as entries, got an array of bool"),
        (lambda q, u: [q[1], u[0]], r"dynamics, .* a list or a tuple is no array, try jax\.numpy\.array"),
        (lambda q, u: (q[1], u[0]), r"dynamics, .* a list or a tuple is no array, try jax\.numpy\.array"),
        (lambda q, u: None, "^dynamics must return a tangent vector, got nothing; did it forget to return"),
        (lambda q, u: cart(q, u)[:, None], r"dynamics, .* has shape \(2,\), got \(2, 1\)"),
        (lambda q, u: q.speed, "the problem's functions fail at a point q of .* has no attribute"),
        (lambda q, u: "fast", "the problem's functions fail at a point q of .* not a valid JAX type"),
    ],
)
def test_what_is_no_velocity_is_named(dynamics, words):
    given = OptimalControlProblem(PLANE, dynamics, effort, 1)
    for run in (lambda: solve(given, REST, AHEAD, 1.0, method=MIDPOINT, steps=4), lambda: classify(given)):
        with pytest.raises(InvalidInputError, match=words):
            run()


@pytest.mark.parametrize("start", [REST + 0j, np.zeros(2, bool), np.array(["a", "b"]), np.array([None, 1])])
def test_points_of_other_kinds_are_refused(start):
    with pytest.raises(
        NotOnManifoldError, match=r"start: .* (real entries, got complex|numbers as entries, got an array)"
    ):
        solve(OptimalControlProblem(PLANE, cart, effort, 1), start, AHEAD, 1.0, method=MIDPOINT, steps=4)


def test_whole_numbers_are_numbers():
    """A terminal cost of 3, a velocity of 2, and the Hamiltonian 0."""
    line = OptimalControlProblem(LINE, lambda q, u: 2 + jnp.array([1]) * u, effort, 1, terminal_cost=lambda q: 3)
    solution = solve(line, np.zeros(1, int), None, 1, method=Midpoint(Addition(LINE)), steps=4)
    assert solution.cost == 3
    assert solution.states[-1] == pytest.approx(2)
    still = integrate(lambda q, p: 0, SYMPLECTIC, (REST, AHEAD), 0.1, 2)
    assert norm((still.q[-1] - REST, still.p[-1] - AHEAD)) == 0


@pytest.mark.parametrize("where", ["dynamics", "running_cost"])
def test_single_precision_is_raised_with_a_warning(where):
    warn_of_coarse_values.cache_clear()
    functions = {"dynamics": cart, "running_cost": effort}
    exact, function = functions[where], functions[where]
    functions[where] = lambda q, u: function(q, u).astype(jnp.float32)
    assert exact(REST, jnp.ones(1)).dtype == float
    with pytest.warns(UserWarning, match=f"{where} returns float32 values where float64 is in use") as caught:
        solution = solve(
            OptimalControlProblem(PLANE, **functions, controls=1),
            REST,
            AHEAD,
            1.0,
            method=MIDPOINT,
            steps=10,
            tolerance=1e-5,
        )
    assert solution.cost == pytest.approx(600 / 99, rel=1e-5)
    assert caught[0].filename == __file__, "the line is the one that called the library"


def test_single_precision_is_named_where_a_tolerance_asks_for_more():
    coarse = OptimalControlProblem(PLANE, lambda q, u: cart(q, u).astype(jnp.float32), effort, 1)
    found = {}
    for tolerance in (1e-11, 1e-5):
        with catch_warnings():
            simplefilter("ignore")
            compiled = Solver(coarse, MIDPOINT, 10, evaluator="xla")
            found[tolerance] = compiled.solve(REST, AHEAD, 1.0, tolerance=tolerance, throw=False)
    assert found[1e-5].success
    assert not found[1e-11].success
    assert "dynamics returns float32 values where float64 is in use, and no condition can be met" in found[1e-11].result


def branching(q, u):
    if u[0] > 0:
        return u @ u
    return u @ u / 2


class Called(eqx.Module):
    """A function that calls another one."""

    def __call__(self, q, u):
        return branching(q, u)


@pytest.mark.parametrize("cost", [branching, Called(), partial(branching), lambda q, u: branching(q, u)])
def test_a_function_that_jax_cannot_trace_is_named_with_its_line(cost):
    line = branching.__code__.co_firstlineno + 1
    words = (
        rf"fail at a point q of R\^2.* in running_cost, line {line} of {__file__}: JAX cannot trace them \(TracerBool"
    )
    for run in (
        lambda: solve(OptimalControlProblem(PLANE, cart, cost, 1), REST, AHEAD, 1.0, method=MIDPOINT, steps=4),
        lambda: classify(OptimalControlProblem(PLANE, cart, cost, 1)),
    ):
        with pytest.raises(InvalidInputError, match=words):
            run()


def test_an_error_in_a_function_is_found_in_it():
    given = OptimalControlProblem(PLANE, lambda q, u: jnp.stack([q[1], u.speed]), effort, 1)
    with pytest.raises(InvalidInputError, match=rf"in dynamics, line \d+ of {__file__}: .*has no attribute"):
        solve(given, REST, AHEAD, 1.0, method=MIDPOINT, steps=4)


@pytest.mark.parametrize(
    ("cost", "words"),
    [
        (lambda q, u: jnp.arctg(u[0]) ** 2, r"did you mean arctan or"),
        (lambda q, u: jnp.matmull(u, u), r"did you mean matmul"),
        (lambda q, u: PLANE.projekt(q, u), r"did you mean projection\?$"),
        (lambda q, u: PLANE.norm(u) ** 2, r"its attributes are ambient, .*projection"),
        (lambda q, u: PLANE.distance(q, q) + u @ u, r"try the squared distance .* jnp\.sum\(\(x - y\) \*\* 2\)"),
        (lambda q, u: u.speed, "another number of controls, or index what is there$"),
    ],
)
def test_an_attribute_that_is_not_there_is_answered_with_near_names(cost, words):
    with pytest.raises(InvalidInputError, match=words):
        solve(OptimalControlProblem(PLANE, cart, cost, 1), REST, AHEAD, 1.0, method=MIDPOINT, steps=4)
