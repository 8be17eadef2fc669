"""Dynamics that leaves the tangent spaces is an error, with the label of the factor."""

import re

import jax.numpy as jnp
import numpy as np
import pytest
from retrax.integrators import Free, OptimalControlProblem, solve
from retrax.manifolds import Euclidean, NotOnManifoldError, hat
from retrax.retractions import Exponential, Midpoint, Projection, default_retraction

from .problems import SO3, SPHERE, half_square, rotation

STEPS = 3


def test_dynamics_that_leave_the_tangent_space_with_the_control_are_refused():
    """``q' = u`` with any ``u`` of space: tangent at rest, and nowhere else."""
    sloppy = OptimalControlProblem(SPHERE, lambda q, u: u, half_square, 3)
    with pytest.raises(NotOnManifoldError, match="leaves the tangent space"):
        solve(sloppy, np.eye(3)[0], np.eye(3)[1], 1.0, method=Midpoint(Projection(SPHERE)), steps=STEPS)


BODY = SO3 * Euclidean(3) * SPHERE
NAMES = {"states": ("attitude", "rate", "q[2]")}
LEAVING = {  # by factors: velocities that are not tangent, at the start and along the trajectory alone
    "attitude, SO(3)": (lambda q, u: hat(q[1]) + jnp.eye(3), lambda q, u: q[0] @ hat(q[1]) + q[1][0] * q[0]),
    "factor 2, Sphere(2)": (lambda q, u: q[2], lambda q, u: q[1][0] * q[2]),
}


@pytest.mark.parametrize("along", [False, True])
@pytest.mark.parametrize("factor", LEAVING)
@pytest.mark.parametrize("horizon", [1.0, Free(1.0, 0.5, 2.0)])
@pytest.mark.usual(2)
def test_the_factor_whose_tangent_space_is_left_is_named_by_its_label(factor, along, horizon):
    tangent = [lambda q, u: q[0] @ hat(q[1]), lambda q, u: u, lambda q, u: jnp.cross(u, q[2])]
    place = 0 if factor.startswith("attitude") else 2
    tangent[place] = LEAVING[factor][along]
    given = OptimalControlProblem(
        BODY,
        lambda q, u: tuple(f(q, u) for f in tangent),
        lambda q, u: 1 + u @ u,
        3,
        labels=NAMES,
    )
    start, end = (np.eye(3), np.zeros(3), np.eye(3)[0]), (np.eye(3), np.array([0.1, 0.2, 0.0]), None)
    with pytest.raises(NotOnManifoldError, match=re.escape(f"leaves the tangent space of {factor}")):
        solve(given, start, end, horizon, method=Midpoint(default_retraction(BODY)), steps=STEPS)


def test_dynamics_that_is_tangent_at_the_start_alone_is_refused():
    forgotten = OptimalControlProblem(SO3, lambda q, u: hat(u), half_square, 3)
    with pytest.raises(NotOnManifoldError, match=r"along the trajectory.*R @ hat\(w\)"):
        solve(forgotten, np.eye(3), rotation([0.5, 1.0, -0.3]), 1.0, method=Midpoint(Exponential(SO3)), steps=STEPS)
