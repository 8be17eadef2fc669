"""What ``solve`` and ``OptimalControlProblem`` refuse, and the words they use; no success for a wrong point."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from retrax.integrators import Guess, OptimalControlProblem, solve
from retrax.manifolds import ConvergenceError, Euclidean, InvalidInputError, NotOnManifoldError, hat
from retrax.retractions import Addition, Cayley, CotangentLift, Exponential, Midpoint, Projection
from scipy.spatial.transform import Rotation

from tests.support.numerics import norm

from .problems import ELLIPSOID, IDENTITY, KINEMATIC, REST, RIGID, SLEW, SO3, SPHERE, half_square, rotation

STEPS = 3
MAP = Midpoint(Exponential(SO3))
END = rotation([0.5, 1.0, -0.3])
HALF_TURN = rotation([np.pi, 0.0, 0.0])
RESTING = Guess(np.broadcast_to(IDENTITY, (STEPS, 3, 3)), np.zeros((STEPS, 3)))


def slew(problem=KINEMATIC, method=MAP, start=IDENTITY, end=END, horizon=1.0, steps=STEPS, **options):
    return solve(problem, start, end, horizon, method=method, steps=steps, **options)


def turning(q, u):
    return q @ hat(u)


def written(q, u):
    rate = jnp.zeros(3)
    rate[0] = u[0]
    return q @ hat(rate)


def problem(dynamics=turning, cost=half_square, controls=3, manifold=SO3, **options):
    return OptimalControlProblem(manifold, dynamics, cost, controls, **options)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"manifold": "SO3"}, r"manifold must be a Manifold, got 'SO3'"),
        ({"dynamics": None}, r"dynamics must be a function of \(q, u\), got None"),
        ({"cost": 1.0}, r"running_cost must be a function of \(q, u\), got 1.0"),
        ({"controls": "three"}, r"controls must be a Manifold, got 'three'"),
        ({"controls": (3,)}, r"controls must be a Manifold, got \(3,\)"),
        ({"terminal_cost": 1.0}, r"terminal_cost must be a function.*got 1.0"),
        ({"abnormal": "no"}, r"abnormal must be True or False, got 'no'"),
    ],
)
def test_a_problem_is_made_of_manifolds_and_functions(options, words):
    with pytest.raises(InvalidInputError, match=words):
        problem(**options)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"problem": turning}, r"OptimalControlProblem, got <function"),
        ({"method": Exponential(SO3)}, r"discretization map, got GroupExponential.*Midpoint"),
        ({"method": CotangentLift(MAP)}, r"method acts on .*the problem on"),
        ({"method": Midpoint(Cayley(RIGID))}, r"method acts on .*the problem on"),
        ({"method": Midpoint(Exponential(Euclidean(3)))}, r"method acts on .*the problem on"),
        ({"horizon": 0}, "horizon must be a positive finite time, got 0"),
        ({"horizon": -1.0}, "horizon must be a positive finite time, got -1.0"),
        ({"horizon": float("nan")}, "horizon must be a positive finite time, got nan"),
        ({"horizon": float("inf")}, "horizon must be a positive finite time, got inf"),
        ({"horizon": [1.0]}, r"horizon must be a positive finite time, got \[1.0\]"),
        ({"horizon": None}, "horizon must be a positive finite time, got None"),
        ({"horizon": "60"}, "horizon must be a positive finite time, got '60'"),
        ({"steps": 0}, "steps must be a whole number of at least 1, got 0"),
        ({"steps": True}, "steps must be a whole number of at least 1, got True"),
        ({"steps": -2}, "steps must be a whole number of at least 1, got -2"),
        ({"steps": 2.5}, "steps must be a whole number of at least 1, got 2.5"),
        ({"steps": "3"}, "steps must be a whole number of at least 1, got '3'"),
        ({"steps": 2**62}, "steps must be at most 10000000, for want of memory, got 4611"),
        ({"max_iterations": 0}, "max_iterations must be a whole number of at least 1, got 0"),
        ({"tolerance": float("nan")}, "tolerance must be .*positive.* got nan"),
        ({"tolerance": -1.0}, "tolerance must be .*positive.* got -1.0"),
        (
            {"tolerance": 1e-16},
            "tolerance must be .*at least 2.2e-16, which is rounding of float64; got 1e-16; try None",
        ),
    ],
)
def test_arguments_of_the_wrong_kind_are_named(options, words):
    with pytest.raises(InvalidInputError, match=rf"(?s){words}"):
        slew(**options)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"end": 2 * END}, r"end: not on SO.*x'x - I.* is 3, expected at most"),
        ({"end": -END}, r"end: not on SO.*det x - 1.* is 2, expected at most"),
        ({"end": np.eye(2)}, r"end: .*shape \(3, 3\), got \(2, 2\)"),
        ({"start": np.nan * END}, r"start: .*NaN"),
        ({"end": (END,)}, r"end: .*structure array\[3,3\], got \(array\[3,3\],\)"),
        ({"end": Rotation.identity()}, r"end: .*shape \(3, 3\), got Rotation; try its as_matrix\(\)"),
        ({"end": END + 1e-5}, r"end: not on SO\(3\).*; restore\(x\) brings"),
    ],
)
def test_ends_that_are_no_points_are_described(options, words):
    with pytest.raises(NotOnManifoldError, match=words):
        slew(**options)


@pytest.mark.parametrize("given", [END.tolist(), tuple(map(tuple, END.tolist())), jnp.asarray(END)])
@pytest.mark.usual(1)
def test_nested_lists_of_numbers_are_points(given):
    assert slew(end=given).cost == slew(end=END).cost


@pytest.mark.parametrize("end", [1.0, 1, [1.0], [1], np.array([1])])
def test_a_number_is_a_point_of_a_line(end):
    line = OptimalControlProblem(Euclidean(1), lambda q, u: u, half_square, 1)
    found = solve(line, 0.0, end, 1.0, method=Midpoint(Addition(Euclidean(1))), steps=2)
    assert found.cost == pytest.approx(0.5, rel=1e-14)


def test_parts_of_a_product_are_lists_of_numbers():
    start, end = [np.eye(3).tolist(), [0.0, 0.0, 0.0]], (END.tolist(), [0.0, 0.0, 0.0])
    found = solve(SLEW, start, end, 60.0, method=Midpoint(Cayley(RIGID)), steps=STEPS)
    assert (
        found.cost == solve(SLEW, (IDENTITY, REST), (END, REST), 60.0, method=Midpoint(Cayley(RIGID)), steps=STEPS).cost
    )


@pytest.mark.parametrize("digits", range(4, 13))
@pytest.mark.usual(3)
def test_rotations_of_a_few_digits_are_projected_with_a_warning(digits, recwarn):
    """Six digits are projected, with one warning if less than nine are right; five are an error."""
    given = np.round(END, digits)
    if digits < 6:
        with pytest.raises(NotOnManifoldError, match=r"end: not on SO\(3\)"):
            slew(end=given)
        return
    found = slew(end=given)
    assert len([w for w in recwarn if "projected onto the manifold" in str(w.message)]) == (digits < 8)
    assert np.max(np.abs(found.states[-1].T @ found.states[-1] - np.eye(3))) <= 1e-14
    assert np.max(np.abs(found.states[-1] - END)) <= 10.0**-digits


def test_rotations_in_single_precision_are_projected_with_a_warning():
    with pytest.warns(UserWarning, match=r"equations of SO\(3\) to .* projected onto the manifold"):
        found = slew(end=END.astype(np.float32))
    assert np.max(np.abs(found.states[-1].T @ found.states[-1] - np.eye(3))) <= 1e-14


@pytest.mark.parametrize(
    ("start", "words"),
    [
        ((IDENTITY,), r"start: .*structure \(array\[3,3\], array\[3\]\), got \(array\[3,3\],\)"),
        (IDENTITY, r"start: .*structure \(array\[3,3\], array\[3\]\), got array\[3,3\]"),
        ((REST, IDENTITY), r"start, factor 0: .*shape \(3, 3\), got \(3,\)"),
        ((2 * IDENTITY, REST), r"start, factor 0: not on SO"),
        ((IDENTITY, np.array([0.0, np.nan, 0.0])), r"start, factor 1: .*NaN"),
    ],
)
def test_points_of_a_product_are_checked_factor_by_factor(start, words):
    with pytest.raises(NotOnManifoldError, match=words):
        solve(SLEW, start, (END, REST), 60.0, method=Midpoint(Cayley(RIGID)), steps=STEPS)


def test_ends_that_are_both_free_need_a_guess():
    with pytest.raises(InvalidInputError, match="free at the other end too; pass a guess"):
        slew(start=None, end=None)


def test_a_manifold_of_the_same_shape_and_dimension_is_another_manifold():
    on_sphere = problem(lambda q, u: SPHERE.projection(q, u), manifold=SPHERE)
    with pytest.raises(InvalidInputError, match=r"method acts on .*the problem on"):
        solve(on_sphere, np.eye(3)[0], np.eye(3)[1], 1.0, method=Midpoint(Projection(ELLIPSOID)), steps=STEPS)


@pytest.mark.parametrize(
    ("options", "error", "words"),
    [
        ({"dynamics": lambda q, u: q + q @ hat(u)}, NotOnManifoldError, "leaves the tangent space .*normal part is"),
        ({"dynamics": lambda q, u: hat(u)}, NotOnManifoldError, "leaves the tangent space"),
        ({"dynamics": lambda q, u: u}, InvalidInputError, r"dynamics.*shape \(3, 3\), got \(3,\)"),
        ({"dynamics": lambda q, u: (q @ hat(u),)}, InvalidInputError, "dynamics.*structure"),
        ({"controls": 2}, InvalidInputError, r"fail at .*control u of R\^2.*try another number of controls"),
        ({"dynamics": lambda q, u: q @ hat(u / [1.0, 2.0, 3.0])}, InvalidInputError, r"line .*instead of a list"),
        ({"dynamics": lambda q, u: (q, u)[2]}, InvalidInputError, r"out of .*index what is there"),
        ({"dynamics": written}, InvalidInputError, r"item assignment.*try jnp.stack"),
        (
            {"dynamics": lambda u, q: q @ hat(u.reshape(3))},
            InvalidInputError,
            r"fail at .*its arguments are \(q, u\), in this order",
        ),
        (
            {"cost": lambda q, u: u @ np.ones(4)},
            InvalidInputError,
            r"fail at .*shape \(3,\), in running_cost, line .*: .*try another",
        ),
        ({"cost": lambda q, u: u * u}, InvalidInputError, r"running_cost must return a scalar, got .*\(3,\)"),
        ({"terminal_cost": lambda q: q}, InvalidInputError, r"terminal_cost must return a scalar, got .*\(3, 3\)"),
        (
            {"cost": lambda q, u: u @ u / jnp.trace(q - IDENTITY)},
            InvalidInputError,
            r"finite at .*u = \[0. 0. 0.\].*cost nan",
        ),
        (
            {"dynamics": lambda q, u: q @ hat(u * jnp.sqrt(1e-4 - u @ u))},
            InvalidInputError,
            r"at .*u = \[.\d\.\d.* velocity nan",
        ),
        ({"cost": lambda q, u: jnp.sqrt(u @ u)}, InvalidInputError, r"no finite derivative .*try .*u @ u"),
        (
            {"cost": lambda q, u: np.sin(u) @ u},
            InvalidInputError,
            r"JAX cannot trace them \(Tracer\w+\), in .*; try jnp.sin instead of np.sin",
        ),
    ],
)
def test_functions_that_return_the_wrong_thing_are_named(options, error, words):
    """Also dynamics that are tangent at rest only: ``hat(u)`` is not tangent at a rotation other than the identity."""
    with pytest.raises(error, match=rf"(?s){words}"):
        slew(problem(**options), start=rotation([0.2, 0.0, 0.0]) if "dynamics" in options else IDENTITY)


@pytest.mark.parametrize(
    ("guess", "words"),
    [
        (RESTING._replace(states=RESTING.states[:2]), r"guess: states must have shapes \(3, 3, 3\), got \(2, 3, 3\)"),
        (RESTING._replace(controls=np.zeros((STEPS, 2))), r"guess: controls must have shapes \(3, 3\), got \(3, 2\)"),
        (RESTING._replace(costates=RESTING.states), r"guess: costates must have shapes \(4, 3, 3\), got \(3, 3, 3\)"),
        (RESTING._replace(controls=np.full((STEPS, 3), np.nan)), "guess: controls has entries that are NaN"),
        (RESTING._replace(states=1.5 * RESTING.states), "guess: states"),
        (RESTING._replace(states=RESTING.states + 0j), "guess: states must be real numbers"),
        (RESTING._replace(controls=np.full((STEPS, 3), "a")), "guess: controls must be real numbers"),
        (tuple(RESTING[:2]), r"guess must be a Guess"),
        ("default", r"guess must be a Guess"),
    ],
)
def test_a_guess_has_the_shapes_of_the_stages(guess, words):
    with pytest.raises(InvalidInputError, match=words):
        slew(guess=guess)


def test_whole_numbers_and_lists_that_mean_a_point_are_taken():
    """NumPy's integers count steps, an integer matrix is the identity, a list holds the factors of a product."""
    expected = slew()
    assert slew(steps=np.int64(STEPS), start=np.eye(3, dtype=int), horizon=1).cost == pytest.approx(
        expected.cost, rel=1e-12
    )
    body = Midpoint(Cayley(RIGID))
    as_tuple = solve(SLEW, (IDENTITY, REST), (END, REST), 60.0, method=body, steps=STEPS)
    as_list = solve(SLEW, [IDENTITY, REST], [END, REST], 60.0, method=body, steps=STEPS)
    assert as_list.cost == as_tuple.cost


def test_under_a_transformation_it_says_that_it_runs_outside():
    with pytest.raises(InvalidInputError, match=r"outside jit"):
        jax.grad(lambda horizon: slew(horizon=horizon).cost)(1.0)
    with pytest.raises(InvalidInputError, match=r"outside jit"):
        jax.grad(
            lambda k: solve(problem(lambda q, u: q @ hat(k * u)), IDENTITY, END, 1.0, method=MAP, steps=STEPS).cost
        )(1.0)


@pytest.mark.parametrize("end", [np.diag([1.0, -1.0, -1.0]), HALF_TURN], ids=["exact", "rounded"])
def test_half_a_turn_is_made_one_way_or_the_other(end):
    assert slew(end=end).cost == pytest.approx(np.pi**2 / 2, rel=1e-10)


@pytest.mark.parametrize("degrees", [170, 175, 179.9, 179.99999, 180])
@pytest.mark.usual(1)
def test_a_turn_near_the_edge_of_the_cayley_map_is_found_from_the_default_guess(degrees):
    steps = 10
    end = rotation(np.deg2rad(degrees) * np.array([1.0, 2.0, -2.0]) / 3)
    solution = slew(method=Midpoint(Cayley(SO3)), end=end, steps=steps)
    chord = 4 * steps * np.tan(np.deg2rad(degrees) / (4 * steps))  # the length of equal steps, each of two half ones
    assert solution.cost == pytest.approx(chord**2 / 2, rel=1e-10)
    assert solution.checks.strict_minimum


def test_half_a_turn_is_arrived_at_from_a_trajectory_that_rests_at_the_start():
    """The skew part of ``R1' R2`` vanishes at half a turn too: the gap is that along the arc, which does not."""
    solution = slew(end=HALF_TURN, guess=RESTING)
    assert solution.cost == pytest.approx(np.pi**2 / 2, rel=1e-10)
    assert solution.checks.defect < 1e-10
    turned = np.stack([rotation([a, 0.0, 0.0]) for a in (0.5, 1.5, 2.5)])
    assert slew(end=HALF_TURN, guess=RESTING._replace(states=turned)).cost == pytest.approx(np.pi**2 / 2, rel=1e-10)


def test_a_wrong_attitude_is_no_success_next_to_a_large_position():
    """A gap is measured by the size of its own array, not by that of the largest one."""
    position = np.array([1e12, 0.0, 0.0])
    flying = problem(lambda q, u: (q[0] @ hat(u[:3]), u[3:]), controls=6, manifold=RIGID)
    guess = Guess((RESTING.states, np.broadcast_to(position, (STEPS, 3))), np.zeros((STEPS, 6)))
    start, end = (IDENTITY, position), (HALF_TURN, position)
    for most in (1, 100):
        solution = solve(
            flying,
            start,
            end,
            1.0,
            method=Midpoint(Cayley(RIGID)),
            steps=STEPS,
            guess=guess,
            throw=False,
            max_iterations=most,
        )
        assert solution.success == (most == 100)
    np.testing.assert_allclose(solution.states[0][-1], HALF_TURN, atol=1e-12)


def test_a_guess_off_the_manifold_leads_to_no_trajectory_off_it():
    """With a free end nothing else holds the states: every stage may keep its wrong length."""

    def height(q, u):
        return u @ u / 2 + q[0] ** 2 + 2 * q[1] ** 2 + q[2]

    hill = problem(lambda q, u: SPHERE.projection(q, u), height, manifold=SPHERE)
    states = np.broadcast_to(1.5 * np.array([0.6, 0.8, 0.0]), (4, 3))
    try:
        solution = solve(
            hill,
            None,
            None,
            1.0,
            method=Midpoint(Exponential(SPHERE)),
            steps=4,
            guess=Guess(states, np.zeros((4, 3))),
            throw=False,
        )
    except InvalidInputError:
        return
    assert not solution.success or norm(np.linalg.norm(solution.states, axis=1) - 1) < 1e-8


def test_an_end_that_cannot_be_reached_is_no_success():
    about_one_axis = problem(lambda q, u: q @ hat(u * jnp.array([0.0, 0.0, 1.0])), controls=1)
    solution = slew(about_one_axis, throw=False)
    assert not solution.success
    assert solution.checks.defect > 1e-3
    assert solution.result in " ".join(str(solution).split())
    with pytest.raises(ConvergenceError):
        slew(about_one_axis)


def test_an_end_that_no_control_moves_towards_is_said_to_be_out_of_reach():
    plane = Euclidean(2)
    one_way = problem(lambda q, u: jnp.stack([u[0], 0.0 * u[0]]), controls=1, manifold=plane)
    with pytest.raises(ConvergenceError, match="cannot be reached"):
        solve(one_way, np.zeros(2), np.ones(2), 1.0, method=Midpoint(Exponential(plane)), steps=STEPS)


@pytest.mark.slow
def test_free_ends_on_a_level_set_start_from_the_guess():
    """No point is prescribed, so that none but the guess's is there to look at."""

    def height(q, u):
        return u @ u / 2 + 2 * q[0] + q[1] ** 2

    final = {"terminal_cost": lambda q: q[2] / 3}
    sliding = problem(lambda q, u: ELLIPSOID.projection(q, u), height, manifold=ELLIPSOID, **final)
    guess = Guess(np.broadcast_to(np.array([0.0, 0.5, np.sqrt(1 / 6)]), (4, 3)), np.zeros((4, 3)))
    solution = solve(sliding, None, None, 1.0, method=Midpoint(Projection(ELLIPSOID)), steps=4, guess=guess)
    assert solution.cost < -1.5
    assert solution.checks.manifold_violation < 1e-9
    assert (
        norm(
            (solution.costates[0], solution.costates[-1] + ELLIPSOID.projection(solution.states[-1], np.eye(3)[2] / 3))
        )
        < 1e-9
    )


def test_parameters_that_do_not_fit_are_named():
    words = r"incompatible shapes.*; parameters have the shapes \(2,\), try other ones, another number of controls, or"
    with pytest.raises(InvalidInputError, match=words):
        slew(problem(cost=lambda q, u, k: u @ (k * u)), parameters=np.ones(2))
