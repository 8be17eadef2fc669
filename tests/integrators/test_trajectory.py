"""Integration over many steps: what is saved, transformations, time reversal, failure."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from retrax.integrators import Composition, Result, SymplecticIntegrator, integrate
from retrax.manifolds import ConvergenceError, CotangentBundle, Euclidean, InvalidInputError, NotOnManifoldError, Sphere
from retrax.manifolds.numerics import ambient as vec
from retrax.retractions import Addition, CotangentLift, Gauss, Midpoint, Projection

from tests.support.numerics import CENTRAL_NODES as DIFFERENCE_NODES
from tests.support.numerics import SEEDS, differences, norm

from .problems import SPHERE, at, pendulum_energy

STEPS = 12
MIDPOINT = SymplecticIntegrator(CotangentLift(Midpoint(Projection(SPHERE))))
START = jnp.array([1.0, 0.0, 0.0]), jnp.array([0.0, 0.6, 0.3])


def swing(start=START, h=0.1, **options):
    return integrate(pendulum_energy, MIDPOINT, start, h, STEPS, **options)


def test_nodes_and_times_are_equally_spaced_from_the_start():
    trajectory = swing()
    assert np.array_equal(trajectory.q[0], START[0])
    assert norm(trajectory.times - 0.1 * np.arange(STEPS + 1)) < 1e-15
    assert norm(trajectory.stage_times - 0.1 * (np.arange(STEPS) + 0.5)) < 1e-15
    assert trajectory.q.shape == trajectory.p.shape == (STEPS + 1, 3)
    assert trajectory.result == Result.successful
    assert trajectory.failed_step == -1
    assert trajectory.controls is None


def test_saving_one_state_in_four_keeps_every_fourth():
    every, fourth = swing(), swing(save_every=4)
    assert norm((fourth.q - every.q[::4], fourth.p - every.p[::4])) < 1e-15
    assert norm(fourth.times - every.times[::4]) < 1e-15
    assert norm(fourth.stage_times - every.stage_times[3::4]) < 1e-15


def test_the_start_may_have_a_covector_with_a_normal_part():
    raised = swing((START[0], START[1] + 5 * START[0]))
    assert norm((raised.q - swing().q, raised.p - swing().p)) < 1e-14


@pytest.mark.slow
@given(seed=SEEDS, h=st.floats(0.01, 0.2))
def test_a_symmetric_map_backward_in_time_returns(seed, h):
    start = CotangentBundle(SPHERE).random_point(jax.random.key(seed))
    there = swing(start, h)
    back = swing(at((there.q, there.p), -1), -h)
    assert norm(vec.subtract(at((back.q, back.p), -1), start)) < 1e-12


def test_a_batch_is_the_loop_over_its_members():
    starts = jax.jit(jax.vmap(CotangentBundle(SPHERE).random_point))(jax.random.split(jax.random.key(2), 5))
    batch = jax.vmap(lambda *start: swing(start))(*starts)
    for i in range(5):
        single = swing(at(starts, i))
        assert norm((batch.q[i] - single.q, batch.p[i] - single.p)) < 1e-13


@pytest.mark.slow
def test_derivatives_by_start_and_step_size_agree_with_differences():
    """Along a curve of starts on ``T*S^2``, with a step size that changes too."""

    def height(s):
        q = jnp.array([jnp.cos(s), jnp.sin(s), 0.0])
        trajectory = swing((q, jnp.array([0.2, 0.6, 0.3 + s])), 0.1 + s / 50)
        return trajectory.q[-1] @ jnp.array([1.0, 2.0, 3.0]) + jnp.sin(trajectory.p[-1, 1])

    points = 0.4 + 1e-2 * np.append(DIFFERENCE_NODES, 0.0)
    values, slopes = jax.jit(jax.vmap(jax.value_and_grad(height)))(points)
    assert slopes[-1] == pytest.approx(differences(np.asarray(values[:-1]), 1e-2), rel=1e-9)


def test_a_step_that_cannot_be_solved_is_an_error_in_words():
    with pytest.raises(ConvergenceError, match=r"step 0, from t = 0: .*could not be solved.*smaller step size"):
        swing(h=1e4)


def test_without_throwing_a_failed_trajectory_says_so_and_stays_finite():
    trajectory = swing(h=1e4, throw=False)
    assert trajectory.result != Result.successful
    assert "smaller step size" in Result[trajectory.result]
    assert trajectory.failed_step == 0
    assert norm((trajectory.q - START[0], trajectory.p - START[1])) == 0.0


def test_a_trajectory_that_fails_midway_is_constant_from_there():
    """The energy is a number only below z = 1/2."""
    start = START[0], jnp.array([0.0, 0.0, 1.0])
    trajectory = integrate(lambda q, p: p @ p / 2 + jnp.sqrt(0.5 - q[2]), MIDPOINT, start, 0.1, STEPS, throw=False)
    failed = int(trajectory.failed_step)
    assert 0 < failed < STEPS
    moving = norm(np.diff(trajectory.q[: failed + 1], axis=0))
    assert moving > 0.05
    assert norm(trajectory.q[failed:] - trajectory.q[failed]) == 0.0


NOT_FINITE = {
    "root": (
        lambda q, p: jnp.sqrt(q[2] - 0.85) + p @ p / 2,
        np.array([0.0, 1.0, 0.0]),
        "is not finite .* value is nan",
    ),
    "norm": (lambda q, p: jnp.sqrt(p @ p), np.zeros(3), r"has no finite derivatives .* they are \[.*nan"),
    "pole": (lambda q, p: 1 / q[1] + p @ p / 2, np.array([0.0, 1.0, 0.0]), "is not finite .* value is inf"),
}
METHODS = {
    "midpoint": MIDPOINT,
    "Gauss": SymplecticIntegrator(Gauss(2, Projection(SPHERE))),
    "composition": Composition(MIDPOINT),
}


@pytest.mark.parametrize("throw", [True, False])
@pytest.mark.parametrize("evaluator", ["tape", "xla"])
@pytest.mark.parametrize(
    ("name", "method"), [("root", "midpoint"), ("root", "Gauss"), ("root", "composition"), ("norm", "Gauss")]
)
@pytest.mark.usual(2)
def test_a_hamiltonian_that_is_not_finite_at_the_start_is_refused(name, method, evaluator, throw):
    """Whatever the size of the step, which is not to blame."""
    hamiltonian, p, words = NOT_FINITE[name]
    start = np.array([0.6, 0.0, 0.8]), p
    for h in (1e-6, 0.1):
        with pytest.raises(InvalidInputError, match=rf"Hamiltonian {words}") as refused:
            integrate(hamiltonian, METHODS[method], start, h, 10, throw=throw, evaluator=evaluator)
        assert "at the start, at q = [0.6 0.  0.8]" in str(refused.value)
        assert "step size" not in str(refused.value)


@pytest.mark.parametrize("every", [1, 5])
def test_a_pole_at_the_start_is_refused_where_a_later_step_fails(every):
    """The first steps leave it."""
    hamiltonian, p, words = NOT_FINITE["pole"]
    with pytest.raises(InvalidInputError, match=rf"Hamiltonian {words}"):
        integrate(hamiltonian, METHODS["Gauss"], (np.array([0.6, 0.0, 0.8]), p), 0.1, 10, every)


@pytest.mark.parametrize(
    ("speed", "blamed"), [(0.9, "the Hamiltonian is not finite where this step"), (1.0, "smaller")]
)
def test_a_trajectory_that_leaves_the_domain_names_the_node_outside_it(speed, blamed):
    """From a node outside no size of the next step helps; from one inside it may."""
    start = START[0], np.array([0.0, 0.0, speed])

    def walled(q, p):
        return p @ p / 2 + jnp.sqrt(0.5 - q[2])

    stopped = integrate(walled, MIDPOINT, start, 0.1, STEPS, throw=False)
    assert np.isfinite(walled(stopped.q[-1], stopped.p[-1])) == (speed == 1.0)
    with pytest.raises(ConvergenceError, match=rf"step {int(stopped.failed_step)}, .*{blamed}"):
        integrate(walled, MIDPOINT, start, 0.1, STEPS)


class Measured(Sphere):
    """A sphere whose equation is a function of Python."""

    def violations(self, x):
        return {"off": jax.pure_callback(lambda x: np.abs(x @ x - 1), jax.ShapeDtypeStruct((), x.dtype), x)}


def test_equations_of_a_manifold_may_call_python():
    """JAX maps no such callback over several points, and knows no tape of it."""
    integrator = SymplecticIntegrator(CotangentLift(Midpoint(Projection(Measured(2)))))
    assert np.array_equal(integrate(pendulum_energy, integrator, START, 0.1, 2).q, swing().q[:3])
    with pytest.raises(NotOnManifoldError, match=r"start: not on .* off is 3"):
        integrate(pendulum_energy, integrator, (2 * START[0], START[1]), 0.1, 2)


class Weighed(Euclidean):
    """A line with a mass of its own."""

    mass: jax.Array

    def __init__(self, mass):
        super().__init__(1)
        self.mass = mass


def test_derivatives_by_an_array_of_the_manifold_need_no_traced_start():
    def end(mass):
        flow = SymplecticIntegrator(Gauss(1, Addition(Weighed(mass))))
        return integrate(lambda q, p: p @ p / mass / 2, flow, (np.ones(1), np.ones(1)), 0.1, 10).q[-1, 0]

    value, slope = jax.value_and_grad(end)(jnp.asarray(2.0))
    assert value == pytest.approx(1.5, rel=1e-14)
    assert slope == pytest.approx(-0.25, rel=1e-13)
