"""Labels and units of a problem: one for each array, or for each entry of one, in records, files, reports and
statements."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from retrax.integrators import Free, OptimalControlProblem, Quantities, load_solution, solve
from retrax.manifolds import SE, SO, Euclidean, InvalidInputError, Power, Product, Sphere, TangentBundle, hat
from retrax.retractions import Addition, Cayley, Gauss, Midpoint

SPACES = [
    Euclidean(()),
    Euclidean(1),
    Euclidean(4),
    SE(3),
    Power(SO(3), 2),
    TangentBundle(Sphere(2)),
    SO(3) * Euclidean(2),
    Product(SO(3) * Euclidean(3), Sphere(2), Euclidean(())),
]
COUNTS = [[1], [1], [4], [16], [18], [3, 3], [9, 2], [9, 3, 3, 1]]


@pytest.mark.parametrize(("space", "counts"), list(zip(SPACES, COUNTS, strict=True)), ids=str)
def test_each_array_has_a_quantity_with_as_many_entries(space, counts):
    k = len(counts)
    words = tuple(f"array {i}" for i in range(k))
    for labels, units in ((None, None), (words, None), (None, words), (words, words)):
        given = [None if x is None else {"states": x if k > 1 else x[0]} for x in (labels, units)]
        found = Quantities.of(space, Euclidean(2), *given)
        assert [len(q.entries) for q in found.states] == counts
        assert [len(set(q.columns)) for q in found.states] == counts
        expected = words if labels else ["q"] if k == 1 else [f"q[{i}]" for i in range(k)]
        assert [q.name for q in found.states] == list(expected)
        assert [q.unit for q in found.states] == (list(words) if units else [""] * k)
        assert Quantities.from_text(found.text) == found
        arrays = tuple(np.zeros((5, count)) for count in counts)
        found.require_fits("", arrays, np.zeros((5, 2)))
        for place in range(k):
            wrong = (*arrays[:place], np.zeros((5, counts[place] + 1)), *arrays[place + 1 :])
            with pytest.raises(InvalidInputError, match="entries"):
                found.require_fits("", wrong, np.zeros((5, 2)))


@pytest.mark.parametrize("count", [1, 2, 3, 4])
def test_entries_of_a_vector_have_names_and_units_if_there_are_as_many(count):
    words = ("x", "y", "heading")
    if count != 3:
        for option in ("labels", "units"):
            with pytest.raises(InvalidInputError, match="one for each of its entries"):
                Quantities.of(
                    Euclidean(count),
                    Euclidean(1),
                    *({"states": words} if option == o else None for o in ("labels", "units")),
                )
        return
    found = Quantities.of(Euclidean(3), Euclidean(1), {"states": words}, {"states": ("m", "m", "rad"), "controls": "N"})
    assert found.states[0].columns == words
    assert [found.states[0].unit_of(i) for i in range(3)] == ["m", "m", "rad"]
    assert found.lines == ["q: x [m], y [m], heading [rad]"]


@pytest.mark.parametrize(
    ("labels", "units"),
    [
        ({"state": "x"}, None),
        ("x", None),
        ({"states": "x"}, None),
        ({"states": ("x", "y", "z")}, None),
        ({"states": ("x", 1)}, None),
        (None, {"time": 1.0}),
        (None, {"horizon": "s"}),
        (None, {"states": ("m", ("m",))}),
    ],
    ids=repr,
)
def test_other_labels_and_units_are_refused(labels, units):
    with pytest.raises(InvalidInputError, match=r"labels|units"):
        OptimalControlProblem(SO(3) * Euclidean(2), lambda q, u: q, lambda q, u: 0.0, 2, labels=labels, units=units)


@pytest.mark.parametrize("horizon", [1.0, Free(1.0)])
def test_bounds_of_controls_are_known_to_solutions_and_files(horizon, tmp_path):
    line = Euclidean(1)
    bounds = (np.array([-np.inf, -3.0]), 2.0)
    problem = OptimalControlProblem(line, lambda q, u: u[:1] + u[1:], lambda q, u: 1 + u @ u, 2, control_bounds=bounds)
    solution = solve(problem, 0.0, 1.0, horizon, method=Gauss(1, Addition(line)), steps=3)
    solution.save(tmp_path / "solution.npz")
    for found in (problem, solution, load_solution(tmp_path / "solution.npz")):
        assert found.quantities.controls[0].bounds == ((-np.inf, 2.0), (-3.0, 2.0))
    assert OptimalControlProblem(line, lambda q, u: u, lambda q, u: u @ u, 1).quantities.controls[0].bounds == ()
    former = solution.quantities.text.replace('"bounds"', '"unknown"')
    assert Quantities.from_text(former).controls[0].bounds == ()
    with pytest.raises(InvalidInputError, match="1 bounds of 2 entries"):
        Quantities.from_text(solution.quantities.text.replace(", [-3.0, 2.0]", ""))


@pytest.mark.parametrize(
    "text", ["", "{}", "[]", '{"states": [], "controls": [], "colour": "red"}', '{"states": [{}], "controls": []}']
)
def test_other_texts_are_no_quantities(text):
    with pytest.raises(InvalidInputError, match="expected names and units"):
        Quantities.from_text(text)


def test_names_follow_a_problem_into_its_solutions_and_their_files(tmp_path):
    names = {
        "labels": {"states": "attitude", "controls": "rate"},
        "units": {"controls": "rad/s", "time": "s", "cost": "rad^2/s"},
    }
    problem = OptimalControlProblem(SO(3), lambda q, u, a: a * q @ hat(u), lambda q, u: 1 + u @ u / 2, 3, **names)
    assert str(problem).splitlines()[-2:] == ["where       q: attitude", "            u: rate [rad/s]"]
    end = np.asarray(Cayley(SO(3))(jnp.eye(3), hat(jnp.array([0.3, 0.2, 0.1]))))
    method = Gauss(1, Cayley(SO(3)))
    for horizon, parameters in ((2.0, 1.0), (Free(2.0), Free(1.0, 0.5, 1.5))):
        solution = solve(problem, np.eye(3), end, horizon, method=method, steps=2, parameters=parameters)
        assert solution.quantities == problem.quantities
        assert "rad^2/s" in str(solution).splitlines()[1]
        solution.save(tmp_path / "solution.npz")
        assert load_solution(tmp_path / "solution.npz").quantities == problem.quantities
    wrong = replace(solution, quantities=replace(problem.quantities, controls=()))
    wrong.save(tmp_path / "wrong.npz")
    with pytest.raises(InvalidInputError, match=r"wrong.npz is not a saved solution: controls have"):
        load_solution(tmp_path / "wrong.npz", Midpoint(Cayley(SO(3))).retraction)
