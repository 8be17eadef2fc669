"""Attitudes out and in: quaternions of both conventions, splines, and attitude ephemerides."""

from datetime import datetime

import jax.numpy as jnp
import numpy as np
import pytest
from retrax.integrators import OptimalControlProblem, Result, Trajectory, solve
from retrax.interop import from_aem, from_quaternions, to_aem, to_quaternions, to_rotation_spline
from retrax.manifolds import SE, SO, Euclidean, InvalidInputError, hat
from retrax.retractions import Cayley, Midpoint
from scipy.spatial.transform import Rotation

ANGLES = np.linspace(-7.0, 7.0, 57)
AXIS = np.array([1.0, 2.0, -2.0]) / 3
TURNS = Rotation.from_rotvec(ANGLES[:, None] * AXIS).as_matrix()
EPOCH = datetime(2026, 2, 28, 23, 59, 30)
NAMES = {"epoch": EPOCH, "object_name": "X-SAT", "object_id": "2011-015C"}


def record(matrices, times=None):
    """A trajectory with these points."""
    times = jnp.linspace(0.0, 56.0, len(matrices)) if times is None else jnp.asarray(times)
    q = jnp.asarray(matrices)
    return Trajectory(times, q, 0 * q, None, times[1:], Result.successful, jnp.asarray(-1))


@pytest.mark.parametrize("scalar", ["first", "last"])
def test_quaternions_there_and_back(scalar):
    found = to_quaternions(TURNS, scalar)
    k = {"first": 0, "last": 3}[scalar]
    start = np.sign(np.cos(ANGLES[0] / 2))
    np.testing.assert_allclose(found[:, k], start * np.cos(ANGLES / 2), atol=1e-12)
    np.testing.assert_allclose(np.delete(found, k, axis=1), start * np.sin(ANGLES / 2)[:, None] * AXIS, atol=1e-12)
    np.testing.assert_allclose(from_quaternions(found, scalar), TURNS, atol=1e-14)
    np.testing.assert_allclose(
        from_quaternions(-found.reshape(3, 19, 4), scalar), TURNS.reshape(3, 19, 3, 3), atol=1e-14
    )
    assert to_quaternions(TURNS[3], scalar).shape == (4,)
    assert np.linalg.norm(from_quaternions(found, {"first": "last", "last": "first"}[scalar]) - TURNS) > 1


@pytest.mark.parametrize("scale", [0.0, 0.5, 1 - 1e-5, 1 - 1e-7, 1.0, 1 + 1e-7, 1 + 1e-5, 2.0, np.nan])
def test_quaternions_of_another_norm_are_refused(scale):
    q = scale * np.array([[0.5, 0.5, 0.5, 0.5]])
    if abs(scale - 1) < 1e-6:
        np.testing.assert_allclose(from_quaternions(q, "last"), from_quaternions(q / scale, "last"), atol=1e-14)
        return
    with pytest.raises(InvalidInputError, match="norm 1"):
        from_quaternions(q, "last")


@pytest.mark.parametrize("scalar", ["", None, "xyzw", True])
def test_the_convention_is_said(scalar):
    for convert in (to_quaternions, from_quaternions):
        with pytest.raises(InvalidInputError, match="scalar must be"):
            convert(np.zeros((0, 4)), scalar)
        with pytest.raises(TypeError):
            convert(np.zeros((0, 4)))
    for wrong in (2 * TURNS, -TURNS, TURNS[:, :2, :2], TURNS[0, 0]):
        with pytest.raises(InvalidInputError, match="expected rotations"):
            to_quaternions(wrong, "last")


def test_a_spline_goes_through_the_nodes():
    found = to_rotation_spline(record(TURNS), problem=SO(3))
    np.testing.assert_allclose(found(np.linspace(0.0, 56.0, 57)).as_matrix(), TURNS, atol=1e-12)
    # About one axis with one rate, that is what a cubic spline has too.
    np.testing.assert_allclose(found(20.5, 1), AXIS * 0.25, atol=1e-12)


@pytest.mark.parametrize("system", ["UTC", "TAI"])
def test_an_ephemeris_is_read_back(tmp_path, system):
    to_aem(record(TURNS), tmp_path / "slew.aem", **NAMES, time_system=system, problem=SO(3))
    text = (tmp_path / "slew.aem").read_text()
    assert text.splitlines()[0] == "CCSDS_AEM_VERS = 2.0"
    assert "START_TIME = 2026-02-28T23:59:30.000000" in text
    assert "STOP_TIME = 2026-03-01T00:00:26.000000" in text
    found = from_aem(tmp_path / "slew.aem")
    np.testing.assert_allclose(found.attitudes, TURNS, atol=1e-14)
    np.testing.assert_array_equal(found.times, np.linspace(0.0, 56.0, 57))
    assert (found.epoch, found.object_name, found.object_id) == tuple(NAMES.values())
    assert (found.reference, found.body, found.time_system) == ("EME2000", "SC_BODY_1", system)


@pytest.mark.parametrize("direction", ["A2B", "B2A"])
@pytest.mark.parametrize("scalar", ["FIRST", "LAST"])
def test_conventions_of_the_first_version_are_those_of_its_keywords(tmp_path, scalar, direction):
    frames = ("SC_BODY_1", "EME2000") if direction == "B2A" else ("EME2000", "SC_BODY_1")
    row = "0.5 0.1 0.7 0.5" if scalar == "FIRST" else "0.1 0.7 0.5 0.5"
    (tmp_path / "old.aem").write_text(
        f"CCSDS_AEM_VERS = 1.0\nCOMMENT by hand = 1\nMETA_START\nREF_FRAME_A = {frames[0]}\nREF_FRAME_B = {frames[1]}\n"
        f"ATTITUDE_DIR = {direction}\nTIME_SYSTEM = UTC\nATTITUDE_TYPE = quaternion\nQUATERNION_TYPE = "
        f"{scalar}\nMETA_STOP\nDATA_START\n2026-059T23:59:30 {row}\n2026-060T00:00:00.25Z {row}\nDATA_STOP\n"
    )
    found = from_aem(tmp_path / "old.aem")
    assert (found.reference, found.body) == ("EME2000", "SC_BODY_1")
    np.testing.assert_array_equal(found.times, [0.0, 30.25])
    np.testing.assert_allclose(found.attitudes[1], Rotation.from_quat([0.1, 0.7, 0.5, 0.5]).as_matrix(), atol=1e-14)


@pytest.mark.parametrize(
    "change", ["CCSDS_AEM_VERS = 2.0", "REF_FRAME_A", "TIME_SYSTEM", "= QUATERNION", "META_START", "T23"]
)
def test_other_files_are_refused(tmp_path, change):
    path = tmp_path / "slew.aem"
    to_aem(record(TURNS[:3]), path, **NAMES, problem=SO(3))
    path.write_text(path.read_text().replace(change, "X"))
    with pytest.raises(InvalidInputError, match=r"slew\.aem has"):
        from_aem(path)


def test_an_ephemeris_at_times_is_the_solution_there(tmp_path):
    problem = OptimalControlProblem(SO(3), lambda q, u: q @ hat(u), lambda q, u: u @ u / 2, 3)
    solution = solve(problem, np.eye(3), TURNS[30], 2.0, method=Midpoint(Cayley(SO(3))), steps=3)
    for times in (solution.times, np.linspace(0.5, 1.5, 9)):
        to_aem(solution, tmp_path / "slew.aem", **NAMES, at=times)
        found = from_aem(tmp_path / "slew.aem")
        np.testing.assert_allclose(found.times, times - times[0], atol=1e-6)
        np.testing.assert_allclose(found.attitudes, solution(times).states, atol=1e-14)
    for given, at in ((record(TURNS), [0.0, 1.0]), (solution, "stages")):
        with pytest.raises(InvalidInputError, match='at must be "nodes"'):
            to_aem(given, tmp_path / "slew.aem", **NAMES, at=at, problem=SO(3) if given is not solution else None)


def test_what_is_no_ephemeris_is_not_written(tmp_path):
    path = tmp_path / "slew.aem"
    with pytest.raises(InvalidInputError, match="must ascend"):
        to_aem(record(TURNS[:2], [0.0, -1.0]), path, **NAMES, problem=SO(3))
    with pytest.raises(InvalidInputError, match="one line"):
        to_aem(record(TURNS), path, **{**NAMES, "object_name": "X\nSTOP"}, problem=SO(3))
    for space in (Euclidean((3, 3)), None):
        with pytest.raises(InvalidInputError, match=r"SO\(3\) or SE\(3\)"):
            to_aem(record(TURNS), path, **NAMES, problem=space)
    assert not path.exists()
    poses = np.tile(np.eye(4), (57, 1, 1))
    poses[:, :3, :3] = TURNS
    to_aem(record(poses), path, **NAMES, problem=SE(3))
    np.testing.assert_allclose(from_aem(path).attitudes, TURNS, atol=1e-14)
