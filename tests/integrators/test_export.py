"""Exported solvers find what Python finds, compile without warnings, allocate nothing, and refuse bad input."""

from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
import pytest
from retrax.compute.binding import transcription
from retrax.integrators import Free, OptimalControlProblem, Solver, default_guess
from retrax.manifolds import Euclidean, InvalidInputError
from retrax.retractions import Addition, Cayley, Gauss, Midpoint, default_retraction

from tests.integrators.problems import IDENTITY, REST, RIGID, SLEW, SLEW_END, SPHERE, half_square, rotation, spacecraft
from tests.support.exported import (
    ARITHMETIC,
    STATUSES,
    WARNINGS,
    Flown,
    built_and_tested,
    compile_loop_of_the_page,
    ran,
    require,
)

PLANE = Euclidean(2)
NORTH, EAST = np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0])
SOUTHEAST = np.array([0.8, 0.0, -0.6])
HALF_WAY = rotation(np.deg2rad(80.0) * np.array([1.0, 0.0, 0.0]))


class Case(NamedTuple):
    """A solver, what is asked of it first, and what is asked next of the exported one with the same guess."""

    solver: Solver
    first: tuple
    next: tuple
    options: Mapping[str, Any] = MappingProxyType({})
    next_options: Mapping[str, Any] = MappingProxyType({})


def limited() -> OptimalControlProblem:
    """A slew with torque limits that hold it."""
    return OptimalControlProblem(RIGID, spacecraft, half_square, 3, control_bounds=(-10.0, 10.0))


def turn() -> OptimalControlProblem:
    """A turn of a direction, whose functions have parameters."""
    return OptimalControlProblem(
        SPHERE, lambda q, u, own: own["gain"] * jnp.cross(u, q), lambda q, u, own: u @ u / 2 + own["field"] @ q, 3
    )


def particle(**options: Any) -> OptimalControlProblem:
    """A mass on a line."""
    return OptimalControlProblem(PLANE, lambda q, u: jnp.stack([q[1], u[0]]), controls=1, **options)


def beside(q: Any, u: Any = None) -> Any:
    """A disk beside the straight line between the ends."""
    return 0.04 - jnp.sum((q - jnp.array([0.5, 0.05])) ** 2)


FIELDS = {"field": np.array([0.3, 0.0, 1.0]), "gain": 2.0}, {"field": np.array([0.2, 0.1, 1.1]), "gain": 1.8}
SLEWS = ((IDENTITY, REST), (SLEW_END, REST), 60.0), ((IDENTITY, 1e-3 * np.ones(3)), (HALF_WAY, REST), 55.0)
AROUND = (np.zeros(2), np.array([1.0, 0.0]), 1.0), (np.zeros(2), np.array([1.1, 0.0]), 1.2)
CASES = {
    "slew": lambda: Case(Solver(SLEW, Midpoint(Cayley(RIGID)), 20), *SLEWS),
    "slew with torque limits": lambda: Case(Solver(limited(), Midpoint(Cayley(RIGID)), 20), *SLEWS),
    "sphere with parameters": lambda: Case(
        Solver(turn(), Midpoint(default_retraction(SPHERE)), 12), (NORTH, EAST, 1.0), (NORTH, SOUTHEAST, 1.1),
        {"parameters": FIELDS[0]}, {"parameters": FIELDS[1]}
    ),
    "slew by collocation with limits": lambda: Case(Solver(limited(), Gauss(2, Cayley(RIGID)), 8), *SLEWS),
    "least time": lambda: Case(
        Solver(particle(running_cost=lambda q, u: 1.0, control_bounds=(-1.0, 1.0)), Midpoint(Addition(PLANE)), 20),
        (np.zeros(2), np.array([1.0, 0.0]), Free(3.0)), (np.zeros(2), np.array([1.2, 0.1]), Free(3.0)),
    ),
    "bounded horizon and an explicit time": lambda: Case(
        Solver(OptimalControlProblem(PLANE, lambda q, u, t: jnp.stack([q[1], u[0]]), lambda q, u, t: u @ u + t, 1,
                                     time_dependent=True), Midpoint(Addition(PLANE)), 10),
        (np.zeros(2), np.array([1.0, 0.0]), Free(2.0, upper=2.5)),
        (np.zeros(2), np.array([1.1, 0.0]), Free(2.0, upper=2.5)),
    ),
    "free end": lambda: Case(
        Solver(particle(running_cost=half_square, terminal_cost=lambda q: 5.0 * (q[0] - 0.5) ** 2 + q[1] ** 2),
               Gauss(3, Addition(PLANE)), 4),
        (np.ones(2), Free(np.zeros(2)), 1.0), (np.array([1.0, 0.5]), Free(np.zeros(2)), 1.2)
    ),
    "obstacle": lambda: Case(
        Solver(OptimalControlProblem(PLANE, lambda q, u: u, half_square, 2, constraints={"disk": beside}),
               Midpoint(Addition(PLANE)), 16), *AROUND
    ),
    "obstacle at the nodes of collocation": lambda: Case(
        Solver(OptimalControlProblem(PLANE, lambda q, u: u, half_square, 2, node_constraints={"disk": beside}),
               Gauss(2, Addition(PLANE)), 8), *AROUND
    ),
    "measurements at the nodes of collocation": lambda: Case(
        Solver(OptimalControlProblem(PLANE, lambda q, u, p: jnp.stack([q[1], u[0]]), lambda q, u, p: u @ u / 2, 1,
                                     node_cost=lambda q, k, p: 50.0 * (q[0] - p["y"][k]) ** 2),
               Gauss(2, Addition(PLANE)), 6),
        (np.zeros(2), Free(np.zeros(2)), 1.0), (np.array([0.1, 0.0]), Free(np.zeros(2)), 1.2),
        {"parameters": {"y": np.sin(np.arange(7.0))}}, {"parameters": {"y": np.cos(np.arange(7.0))}},
    ),
    "control on a sphere": lambda: Case(
        Solver(OptimalControlProblem(Euclidean(3), lambda q, u: u, lambda q, u: 1.0 + q @ q, SPHERE),
               Midpoint(Addition(Euclidean(3))), 10),
        (np.zeros(3), np.array([0.6, 0.5, 0.2]), Free(1.0)), (np.zeros(3), np.array([0.6, 0.4, 0.3]), Free(1.0))
    ),
}  # fmt: skip


@pytest.fixture(autouse=True)
def _searches_of_the_core(monkeypatch):
    """Searches with the instruction set of the program: rounding of products and sums moves the
    costates of least time, which the tolerance hardly determines, by 1e-6."""
    monkeypatch.setattr(transcription, "best_instruction_set", lambda: 0)


def flat(points: Any) -> np.ndarray:
    """Arrays of points, as the columns of the C program."""
    leaves = points if isinstance(points, tuple) else (points,)
    return np.concatenate([np.reshape(leaf, (len(leaf), -1)) for leaf in leaves], axis=1)


def close(found: Any, expected: np.ndarray, most: float = 1e-12) -> None:
    """Numbers that differ by rounding, relative to the largest one."""
    np.testing.assert_allclose(found, expected, rtol=0, atol=most * max(1.0, np.abs(expected).max(initial=0.0)))


def agrees(flown: Any, solution: Any) -> None:
    """The output of an exported program is a solution in Python."""
    assert STATUSES[flown["status"]] == "SOLVED"
    assert flown["iterations"] == solution.statistics.iterations
    states, costates = flat(solution.states), flat(solution.costates)
    own = np.s_[:, : states.shape[1]]
    close(flown["states"][own], states)
    close(flown["costates"][own], costates)
    close(flown["solution"]["controls"].reshape(len(solution.stage_times), -1), flat(solution.controls))
    for name in ("cost", "horizon", "times"):
        close(flown[name], np.asarray(getattr(solution, name)))
    assert flown["strict_minimum"] in (solution.checks.strict_minimum, False)
    for name in ("defect", "stationarity"):
        assert abs(flown[name] - getattr(solution.checks, name)) <= 1e-12


def entries(point: Any) -> np.ndarray:
    """The entries of an end."""
    parts = point if isinstance(point, tuple) else (getattr(point, "guess", point),)
    return np.concatenate([np.ravel(part) for part in parts])


@pytest.mark.usual("slew with torque limits", "sphere with parameters")
@pytest.mark.parametrize("name", CASES)
def test_the_program_finds_what_python_finds(name, tmp_path, core):
    case = CASES[name]()
    solution = case.solver.solve(*case.first, **case.options)
    flown = Flown(case.solver.export_c(tmp_path / "own", "own", solution), "own", core, "-O1")
    found = flown.solve(flown.default)
    agrees(found, solution)
    if found["strict_minimum"]:
        assert solution.checks.strict_minimum

    start, end, horizon = case.next
    given = flown.default.copy()
    given["start"], given["end"] = entries(start), entries(end)
    given["horizon"] = getattr(horizon, "guess", horizon)
    if "parameters" in case.next_options:
        own = case.next_options["parameters"]
        given["parameters"] = np.concatenate([np.ravel(own[key]) for key in sorted(own)])
    problem, method, steps = case.solver.problem, case.solver.method, case.solver.fractions
    guess = default_guess(problem, method, *case.first[:2], steps)
    agrees(flown.solve(given), case.solver.solve(*case.next, guess, **case.next_options))

    given["guess"] = flown.solve(given)["solution"]
    again = flown.solve(given)
    assert STATUSES[again["status"]] == "SOLVED"
    assert again["iterations"] <= 3
    close(again["states"], flown.solve(given)["states"], 1e-8)


@pytest.fixture(scope="module")
def slew(tmp_path_factory):
    """A solver of slews with torque limits, a solution, and the folder of the exported solver."""
    solver = Solver(limited(), Midpoint(Cayley(RIGID)), 20)
    solution = solver.solve(*SLEWS[0])
    return solver, solution, solver.export_c(tmp_path_factory.mktemp("slew") / "flight", "slew", solution)


@pytest.mark.usual("gcc")
@pytest.mark.parametrize("compiler", ["gcc", "clang"])
def test_a_folder_builds_and_passes_its_test_without_warnings(compiler, tmp_path, slew):
    said = built_and_tested(slew[2], tmp_path, compiler)
    assert "status 0 after" in said
    assert "from the solution: status 0" in said


def test_the_control_loop_of_the_page_compiles(tmp_path, slew):
    compile_loop_of_the_page("slew.h", slew[2], tmp_path)


def unlimited() -> OptimalControlProblem:
    """A slew to a free end with a cost."""
    return OptimalControlProblem(
        RIGID,
        spacecraft,
        half_square,
        3,
        terminal_cost=lambda q: 50.0 * jnp.sum((q[0] - SLEW_END) ** 2) + 1e6 * q[1] @ q[1],
    )


@pytest.mark.parametrize(
    ("make", "end", "most"),
    [(unlimited, None, 1e-10), (lambda: SLEW, (SLEW_END, REST), 1e-10), (limited, (SLEW_END, REST), 1e-7)],
    ids=["free end", "fixed end", "torque limits"],
)
@pytest.mark.usual(1)
def test_gains_are_those_of_the_feedback_in_python(make, end, most, tmp_path, core):
    """At the nodes from which the controls can correct everything; limits hold as far as the barrier lets them."""
    solver = Solver(make(), Gauss(2, Cayley(RIGID)), 8)
    solution = solver.solve((IDENTITY, REST), end, 60.0)
    law = solver.feedback(solution)
    flown = Flown(solver.export_c(tmp_path / "own", "own", solution, gains=True), "own", core, "-O1")
    found = flown.solve(flown.default)
    agrees(found, solution)
    frames = np.stack([frame_at(own, w) for own, w in zip(*solution.states, strict=True)])[:-1]
    gains = np.einsum("ksie,kae->ksia", found["gains"], frames)
    expected = law.gains.reshape(gains.shape)
    before = solution.times[:-1] <= law.until
    assert before.sum() >= 5
    assert np.abs(gains - expected)[before].max() <= most * np.abs(expected[before]).max()


def frame_at(attitude: np.ndarray, rate: np.ndarray) -> np.ndarray:
    """The basis of the manifold at a state, a flat vector in each row."""
    return flat(tuple(np.asarray(part) for part in RIGID.basis((attitude, rate))))


LIBRARY = (
    "acos acosh asin asinh atan atan2 atanh copysign cos cosh erf exp expm1 fabs floor ceil fma fmax fmin fmod hypot "
    "log log1p pow sin sinh sqrt tan tanh memcpy memset memmove __stack_chk_fail"
)


def test_a_program_calls_nothing_but_libm_and_copies(slew, core):
    """No memory is allocated, and nothing is printed."""
    flown = Flown(slew[2], "slew", core, "-O1")
    assert flown.sizes["STEPS"] == 20
    called = {line.split()[-1].split("@")[0] for line in ran("nm", "-D", "-u", slew[2] / "flown.so").splitlines()}
    called -= {"__cxa_finalize", "__gmon_start__", "_ITM_deregisterTMCloneTable", "_ITM_registerTMCloneTable"}
    assert called <= {*LIBRARY.split()}


def test_bad_input_and_a_workspace_of_any_content(slew, core):
    _, solution, folder = slew
    flown = Flown(folder, "slew", core, "-O1")
    expected = flown.solve(flown.default)
    agrees(expected, solution)
    flown.workspace[...] = np.random.default_rng(1).normal(size=flown.workspace.shape)
    assert flown.solve(flown.default) == expected
    assert flown.solve(flown.default, shift=1)["iterations"] == expected["iterations"]

    for field, value in (("horizon", 0.0), ("horizon", -1.0), ("horizon", np.inf), ("start", np.nan), ("end", np.inf)):
        given = flown.default.copy()
        given[field] = value
        found = flown.solve(given)
        assert STATUSES[found["status"]] == "BAD_INPUT"
        assert not found["states"].any()
    given = flown.default.copy()
    given["guess"]["controls"][3] = np.nan
    assert STATUSES[flown.solve(given)["status"]] == "BAD_INPUT"


def test_an_iteration_limit_and_a_tolerance_are_those_of_the_export(tmp_path, slew, core):
    solver, solution, _ = slew
    few = Flown(solver.export_c(tmp_path / "few", "few", solution, max_iterations=3), "few", core, "-O1")
    given = few.default.copy()
    given["end"] = entries((HALF_WAY, REST))
    found = few.solve(given)
    assert STATUSES[found["status"]] == "ITERATION_LIMIT"
    assert max(found[name] for name in ("defect", "stationarity", "complementarity")) > 1e-9
    header, source = ((tmp_path / "few" / name).read_text() for name in ("few.h", "few.c"))
    assert "FEW_MAX_ITERATIONS = 3," in header
    coarse = solver.export_c(tmp_path / "coarse", "coarse", solution, 1e-4)
    assert "tolerance = 0.0001;" in (coarse / "coarse.c").read_text()
    assert "tolerance = 0.0001;" not in source


def test_export_c_says_what_it_cannot_export(tmp_path, slew):
    solver, solution, folder = slew
    with pytest.raises(InvalidInputError, match="not an empty folder; try a new one"):
        solver.export_c(folder, "slew", solution)
    for name in ("2slew", "a-b", "", "double", "retrax_slew", 3):
        with pytest.raises(InvalidInputError, match=r"try another name|identifier of C"):
            solver.export_c(tmp_path / "named", name, solution)
    for other in (None, replace(solution)):
        with pytest.raises(InvalidInputError, match="one and the same solver"):
            solver.export_c(tmp_path / "foreign", "slew", other)
    closed = particle(running_cost=half_square, boundary_constraints={"closed": lambda a, b: b[1] - a[1]})
    bound = Solver(closed, Midpoint(Addition(PLANE)), 6)
    with pytest.raises(InvalidInputError, match="boundary constraints, which export_c does not treat"):
        bound.export_c(tmp_path / "bound", "bound", bound.solve(np.zeros(2), (Free(np.ones(2))), 1.0))
    slow = Solver(particle(running_cost=half_square), Midpoint(Addition(PLANE)), 4, evaluator="xla")
    with pytest.raises(InvalidInputError, match="functions on the evaluator 'xla'"):
        slow.export_c(tmp_path / "xla", "slow", slow.solve(np.zeros(2), np.array([1.0, 0.0]), 1.0))
    assert not list(tmp_path.iterdir())


PROCESSORS = {
    "aarch64": ("aarch64-linux-gnu-gcc", "qemu-aarch64"),
    "arm of 32 bits": ("arm-linux-gnueabihf-gcc", "qemu-arm"),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", PROCESSORS)
def test_the_example_runs_on_other_processors(name, tmp_path, slew):
    """The size of the workspace is that of pointers of 64 bits, and enough for shorter ones."""
    compiler, emulator = PROCESSORS[name]
    require(compiler, emulator)
    sources = [*slew[2].glob("*.c"), *(slew[2] / "core").glob("*.c")]
    flags = [*WARNINGS, *ARITHMETIC, "-O2", "-static"]
    ran(compiler, *flags, *sources, "-lm", "-o", tmp_path / "example", folder=slew[2])
    said = ran(emulator, tmp_path / "example")
    assert "status 0 after 17 iterations" in said
    assert "from the solution: status 0" in said


MOST_FRAME = 4096  # bytes
M7 = ["-mcpu=cortex-m7", "-mthumb", "-mfpu=fpv5-d16", "-mfloat-abi=hard"]


@pytest.mark.slow
def test_a_microcontroller_has_room_for_the_frames(tmp_path, slew):
    """No function needs much stack, none an amount that is not known, and the code has no recursion."""
    require("arm-none-eabi-gcc")
    sources = sorted([slew[2] / "slew.c", slew[2] / "slew_functions.c", *(slew[2] / "core").glob("*.c")])
    options = [*WARNINGS, *ARITHMETIC, "-O2", *M7, f"-I{slew[2]}", f"-I{slew[2] / 'core'}", "-fstack-usage"]
    ran("arm-none-eabi-gcc", *options, "-c", *sources, folder=tmp_path)
    frames = [line.split("\t") for path in tmp_path.glob("*.su") for line in path.read_text().splitlines()]
    assert len(frames) > 100
    assert all("dynamic" not in kind for *_, kind in frames)
    assert max(int(size) for _, size, _ in frames) <= MOST_FRAME
    undefined = {line.split()[-1] for line in ran("arm-none-eabi-nm", "-u", *tmp_path.glob("*.o")).splitlines() if line}
    assert not undefined & {"malloc", "calloc", "realloc", "free", "printf", "_sbrk"}


def test_a_solution_that_another_guess_led_to_is_the_default_guess(tmp_path, core):
    """A car that parks beside itself: at the guess of ``solve`` it rests, and Newton's method cannot set out."""
    space = Euclidean(3)
    car = OptimalControlProblem(
        space, lambda q, u: jnp.stack([u[0] * jnp.cos(q[2]), u[0] * jnp.sin(q[2]), u[1]]), half_square, 2
    )
    solver = Solver(car, Midpoint(Addition(space)), 20)
    solution = solver.solve(np.zeros(3), np.array([0.0, 1.0, 0.0]), 1.0)
    flown = Flown(solver.export_c(tmp_path / "car", "car", solution), "car", core, "-O1")
    assert flown.default["guess"]["controls"].any()
    found = flown.solve(flown.default)
    assert STATUSES[found["status"]] == "SOLVED"
    close(found["states"], solution.states, 1e-9)
    assert found["iterations"] <= 2
