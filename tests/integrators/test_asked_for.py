"""What is asked for and not offered is said in words, and what the words advise does it."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array
from retrax.integrators import OptimalControlProblem, SymplecticIntegrator, integrate, solve
from retrax.integrators.problem.initial_controls import resting_control
from retrax.integrators.problem_checks.costs import require_cost
from retrax.integrators.problem_checks.inspection import probes
from retrax.manifolds import Euclidean, InvalidInputError
from retrax.retractions import Addition, CotangentLift, Midpoint

from tests.integrators.test_kinks import Priced, cart

PLANE, LINE = Euclidean(2), Euclidean(1)
MIDPOINT = Midpoint(Addition(PLANE))
REST, AHEAD = np.zeros(2), np.array([1.0, 0.0])


def effort(_: Array, u: Array) -> Array:
    return u @ u / 2


def require_costs(problem: OptimalControlProblem, fixed: tuple[bool, ...] = ()) -> None:
    """Raise unless both costs are numbers, near the rest and at random ends."""
    u = resting_control(problem.controls)
    require_cost(problem, (REST, u, probes(problem, u)[0]), REST, fixed)


CART = OptimalControlProblem(PLANE, cart, effort, 1)
LABELS = "names belong to OptimalControlProblem: labels=|did you mean labels"
BOUNDS, TIME = "bounds belong to OptimalControlProblem", "time_dependent=True"
ENDS = r"conditions on the ends are start and end of solve, .* boundary_constraints="
HORIZON = r"for a free one give horizon=Free\(guess\)"


@pytest.mark.parametrize(
    ("name", "words"),
    [
        *(
            (name, BOUNDS)
            for name in ("bounds", "control_bounds", "u_max", "umin", "upper", "path_constraints", "lb", "ubx")
        ),
        *((name, HORIZON) for name in ("free_horizon", "free_time", "final_time", "tf", "duration")),
        *((name, TIME) for name in ("time", "t0", "t")),
        *((name, LABELS) for name in ("state_names", "control_names", "names", "state_labels")),
        *((name, "refined until the error is small give accuracy=1e-8") for name in ("tolerance_error", "mesh")),
        *((name, ENDS) for name in ("terminal_constraint", "final_condition", "boundary_constraints")),
        *((name, r"did you mean tolerance\?") for name in ("toleranse", "tol")),
        *((name, r"did you mean start\?") for name in ("x0", "q0", "initial", "initial_state", "init")),
        *((name, r"did you mean end\?") for name in ("xf", "qf", "x1", "goal", "target", "final_state")),
        *((name, r"did you mean guess\?") for name in ("guess_states", "initial_guess", "guesses", "u0", "states")),
        *((name, r"did you mean steps\?") for name in ("N", "n", "n_steps", "num_steps", "nodes", "step")),
        *((name, r"did you mean parameters\?") for name in ("params", "p", "param", "args")),
        *((name, r"did you mean horizon\?") for name in ("T", "horizons")),
        *((name, r"did you mean max_iterations\?") for name in ("max_iter", "maxiter", "iterations")),
        ("quiet", "integrator, callback, verbose, start_time, through$"),
    ],
)
def test_an_option_that_does_not_exist_is_answered(name, words):
    with pytest.raises(InvalidInputError, match=rf"^solve has no option '{name}', expected one of .*({words})"):
        solve(CART, REST, AHEAD, 1.0, method=MIDPOINT, steps=4, **{name: 1})
    if words in (BOUNDS, LABELS) and name not in ("control_bounds", "path_constraints"):
        with pytest.raises(InvalidInputError, match=rf"^OptimalControlProblem has no option '{name}', .*({words})"):
            OptimalControlProblem(PLANE, cart, effort, 1, **{name: (-1, 1)})


@pytest.mark.parametrize(
    ("name", "words"),
    [
        *((name, ENDS) for name in ("terminal_constraint", "terminal_constraints", "end_constraints")),
        ("boundary_constraint", r"did you mean boundary_constraints\?"),
        ("terminal_costs", r"did you mean terminal_cost\?"),
        ("node_constraint", r"did you mean node_constraints\?"),
    ],
)
def test_a_condition_on_the_ends_is_no_terminal_cost(name, words):
    with pytest.raises(InvalidInputError, match=rf"^OptimalControlProblem has no option '{name}', .*; {words}"):
        OptimalControlProblem(PLANE, cart, effort, 1, **{name: lambda q: q})


@pytest.mark.parametrize("horizon", [None, "free", (1.0, 2.0)])
def test_a_free_horizon_is_answered(horizon):
    with pytest.raises(InvalidInputError, match=f"horizon must be a positive finite time.*{HORIZON}"):
        solve(CART, REST, AHEAD, horizon, method=MIDPOINT, steps=4)


@pytest.mark.parametrize(
    ("functions", "words"),
    [
        (
            {"dynamics": lambda q, u, t: cart(q, u)},
            rf"dynamics must be .*\(q, u\).*arguments \(q, u, t\).*{TIME}",
        ),
        (
            {"dynamics": lambda t, q, u: cart(q, u)},
            rf"dynamics must be .*arguments \(t, q, u\).*{TIME}",
        ),
        (
            {"dynamics": lambda q, u, t=0.0: cart(q, u)},
            rf"dynamics must be .*arguments \(q, u, t\).*{TIME}",
        ),
        ({"running_cost": lambda q, u, time: u @ u}, rf"running_cost must be .*{TIME}"),
        (
            {"running_cost": lambda u: u @ u},
            r"running_cost must be a function .*parameters.*arguments \(u\)$",
        ),
        (
            {"terminal_cost": lambda q, horizon: q @ q},
            rf"terminal_cost must be .*arguments \(q, horizon\).*{TIME}",
        ),
    ],
)
def test_functions_of_other_arguments_are_refused(functions, words):
    with pytest.raises(InvalidInputError, match=words):
        OptimalControlProblem(PLANE, **{"dynamics": cart, "running_cost": effort, **functions}, controls=1)
    # A constant, not an argument.
    gain = OptimalControlProblem(PLANE, lambda q, u, gain=2.0: gain * cart(q, u), effort, 1)
    assert gain.velocity(REST, np.ones(1))[1] == 2


def test_a_hamiltonian_of_time_is_refused():
    with pytest.raises(
        InvalidInputError,
        match=r"the Hamiltonian must be .*\(q, p\).*arguments \(q, p, t\).*make a clock s",
    ):
        integrate(lambda q, p, t: p @ p, SymplecticIntegrator(CotangentLift(MIDPOINT)), (REST, REST), 0.1, 2)


@pytest.mark.parametrize("price", [lambda u, a: 1 + a * u @ u, lambda u, a: 60 + a * u[0]])
def test_a_constant_cost_is_told_from_a_weak_one(price):
    def refused(weight: float) -> bool:
        try:
            require_costs(OptimalControlProblem(PLANE, cart, Priced(price, jnp.asarray(weight)), 1))
        except InvalidInputError as error:
            return "every state and control that was tried" in str(error)
        return False

    assert [refused(a) for a in (0.0, 1e-12, 1e-6, 1.0, 1e12)] == [True, False, False, False, False]


@pytest.mark.parametrize(
    "cost",
    [
        lambda q, u: 1,
        lambda q, u: jnp.zeros(()),
        lambda q, u: 0 * u @ u,
        lambda q, u: jnp.cos(q[0]) ** 2 + jnp.sin(q[0]) ** 2,
    ],
)
def test_a_minimum_time_over_a_fixed_horizon_is_refused_at_once(cost):
    """It was solved: every extremal is optimal, and one of them was a success."""
    fixed = OptimalControlProblem(PLANE, cart, cost, 1, terminal_cost=lambda q: q @ q)
    with pytest.raises(InvalidInputError, match=rf"(?s)^the running cost is [01] at every .*{HORIZON}"):
        solve(fixed, REST, AHEAD, 1.0, method=MIDPOINT, steps=10)


class Last(eqx.Module):
    """``3 + weight x``."""

    weight: Array

    def __call__(self, q: Array) -> Array:
        return 3.0 + self.weight * q[0]


def test_a_terminal_cost_that_is_a_number_too_is_no_cost():
    """``3 + a x`` at the end, with ``a`` from nothing through the rounding of 3 to where it counts."""

    def refused(weight: float, *fixed: bool) -> bool:
        given = OptimalControlProblem(PLANE, cart, lambda q, u: 1.0, 1, terminal_cost=Last(jnp.asarray(weight)))
        try:
            require_costs(given, fixed)
        except InvalidInputError as error:
            return "the running cost is 1 at every state and control that was tried, and " in str(error)
        return False

    assert [refused(a) for a in (0.0, 1e-18, 1e-11, 1e-6, 1.0)] == [True, True, False, False, False]
    assert [refused(a, True) for a in (0.0, 1.0)] == [True, True]
    constant = OptimalControlProblem(PLANE, cart, lambda q, u: 1.0, 1, terminal_cost=lambda q: 3.0)
    with pytest.raises(InvalidInputError, match=r"and the terminal cost is 3 at every end: over a fixed horizon"):
        solve(constant, REST, None, 1.0, method=MIDPOINT, steps=10)


def test_other_costs_that_vanish_somewhere_are_not_constant():
    for cost in (lambda q, u: q @ q, lambda q, u: jnp.maximum(u[0] ** 2 - 50.0, 0.0)):
        require_costs(OptimalControlProblem(PLANE, cart, cost, 1))
    require_costs(OptimalControlProblem(PLANE, cart, lambda q, u: 1.0, 1, abnormal=True))


@pytest.mark.parametrize("growth", [0.0, 1e-3, 0.03, 0.1, 0.3, 1.0, 3.0])
def test_costs_that_overflow_far_off_are_not_constant(growth):
    """Controls of some thousands are tried, at which cosh is infinite where it grows fast."""
    given = OptimalControlProblem(PLANE, cart, lambda q, u: jnp.cosh(growth * u[0]), 1)
    if growth:
        assert solve(given, REST, AHEAD, 1.0, method=MIDPOINT, steps=10).checks.strict_minimum
    else:
        with pytest.raises(InvalidInputError, match="the running cost is 1 at every state and control"):
            solve(given, REST, AHEAD, 1.0, method=MIDPOINT, steps=10)


def test_what_is_missing_is_named():
    given = OptimalControlProblem(PLANE, cart, effort, 1)
    with pytest.raises(
        InvalidInputError, match=rf"^solve: missing a required argument: 'horizon', expected solve\(.*{HORIZON}"
    ):
        solve(given, REST, AHEAD)
    with pytest.raises(InvalidInputError, match=r"^solve: too many positional arguments.*are named, as steps=20$"):
        solve(given, REST, AHEAD, 1.0, 20)
    with pytest.raises(InvalidInputError, match=r"^OptimalControlProblem: missing a required argument: 'running_cost'"):
        OptimalControlProblem(PLANE, cart)
