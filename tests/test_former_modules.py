"""Former modules of public classes work with a ``DeprecationWarning``: imports, and pickles of records."""

import importlib
import pickle

import numpy as np
import pytest
import retrax as rx
from retrax.former_names import MODULES
from retrax.integrators import Solution, classify, singular_integrator

FORMER = {present: name for name, present in MODULES.items()}


def speed(q, u):
    return u


def effort(q, u):
    return u @ u / 2


def effort_of_one(q, u):
    return (u[0] ** 2 + q @ q) / 2


def pickled_before(value):
    """The pickle of an object with the former names of its modules, and these names."""
    data, found = pickle.dumps(value, protocol=0), set()
    for present, former in FORMER.items():
        if f"c{present}\n".encode() in data:
            data = data.replace(f"c{present}\n".encode(), f"c{former}\n".encode())
            found.add(former)
    assert b"cretrax.integrators" in data
    assert not [name for name in FORMER if f"c{name}\n".encode() in data]
    return data, found


@pytest.mark.parametrize("name", sorted(MODULES))
def test_a_former_module_has_the_classes_of_the_present_one(name):
    present = importlib.import_module(MODULES[name])
    own = [a for a, value in vars(present).items() if getattr(value, "__module__", None) == present.__name__]
    assert own
    for a in own:
        with pytest.warns(DeprecationWarning, match=rf"{name}.{a} is deprecated; use retrax\..*\.{a}$") as caught:
            assert getattr(importlib.import_module(name), a) is getattr(present, a)
        assert caught[0].filename == __file__


def test_the_warning_names_the_public_place():
    with pytest.warns(DeprecationWarning, match=r"use retrax.integrators.OptimalControlProblem$"):
        from retrax.integrators.problem import OptimalControlProblem
    with pytest.warns(DeprecationWarning, match=r"use retrax.integrators.Free$") as caught:
        from retrax.integrators.free import Free
    assert caught[0].filename == __file__
    with pytest.warns(DeprecationWarning, match=r"use retrax.interop.to_casadi$"):
        from retrax.interop.doors import to_casadi
    assert (OptimalControlProblem, Free) == (rx.OptimalControlProblem, rx.Free)
    assert to_casadi is rx.interop.to_casadi


def test_pickles_that_name_former_modules_are_read():
    plane = rx.Euclidean(2)
    problem = rx.OptimalControlProblem(plane, speed, effort, 2, control_bounds=(-3.0, 3.0))
    method = rx.Midpoint(rx.retractions.Addition(plane))
    solution = rx.solve(problem, np.zeros(2), np.ones(2), 1.0, method=method, steps=4)
    data, names = pickled_before((problem, solution, rx.Free(2.0, 1.0, 3.0)))
    assert names >= {
        f"retrax.integrators.{name}"
        for name in (
            "boundary_conditions",
            "boundary_value.checks",
            "boundary_value.interpolation",
            "boundary_value.solution",
            "constraints",
            "free",
            "problem",
            "quantities",
        )
    }
    with pytest.warns(DeprecationWarning, match="is deprecated") as caught:
        again, found, free = pickle.loads(data)
    assert {str(one.message).split(" is ")[0].rpartition(".")[0] for one in caught} == names
    assert isinstance(found, Solution)
    assert np.array_equal(found.states, solution.states)
    assert np.array_equal(found(0.3).states, solution(0.3).states)
    assert again.manifold == plane
    assert (free.guess, free.lower, free.upper) == (2.0, 1.0, 3.0)


def test_pickled_classifications_and_integrators_that_name_former_modules_are_read():
    plane = rx.Euclidean(2)
    c = classify(rx.OptimalControlProblem(plane, speed, effort_of_one, 2))
    integrator = singular_integrator(c, rx.Midpoint(rx.retractions.Addition(plane)))
    data, names = pickled_before((c, integrator))
    assert names >= {
        f"retrax.integrators.singular.{name}"
        for name in (
            "integrability.final",
            "integrability.hulls",
            "integrability.jets",
            "integrability.levels",
            "strategies.direct",
            "strategies.dynamics",
        )
    }
    with pytest.warns(DeprecationWarning, match="is deprecated"):
        found, again = pickle.loads(data)
    assert str(found) == str(c)
    assert type(again) is type(integrator)


def test_a_module_that_never_was_is_missing():
    with pytest.raises(ModuleNotFoundError, match="nothing"):
        importlib.import_module("retrax.integrators.nothing")
