"""Functions of a library of rigid-body dynamics as tapes, judged by the energy and by a turn of the whole robot."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from retrax import SE
from retrax.tape import Tape
from scipy.spatial.transform import Rotation

frax = pytest.importorskip("frax", reason="the extra bodies is not installed")
G = jnp.array([0, 0, 9.81, 0, 0, 0])


@pytest.fixture(autouse=True)
def _double_precision():
    with jax.enable_x64(True):
        yield


def test_the_power_of_the_torques_is_the_rate_of_the_energy():
    """Energy by heights and velocities of the centres, which inverse dynamics do not use."""
    from frax.assets import FRANKA_ASSETS_DIR
    from frax.core.robot import Robot

    robot = Robot(FRANKA_ASSETS_DIR / "panda.urdf")
    tape = Tape.trace(jax.jit(lambda *x: robot.rnea(*x, G, None)), *[np.zeros(7)] * 3)
    assert tape.instructions < 2000

    def energy(angles, rates):
        poses, moved = jax.jvp(robot.link_to_world_transforms, (angles,), (rates,))
        spins = jnp.einsum("kij,kil->kjl", poses[:, :3, :3], moved[:, :3, :3])  # in the axes of the links
        w = jnp.stack([spins[:, 2, 1], spins[:, 0, 2], spins[:, 1, 0]], axis=1)
        turning = jnp.einsum("ki,kij,kj->", w, robot.link_local_inertias, w)
        moving = robot.link_masses @ jnp.sum(moved[:, :3, 3] ** 2, axis=1)
        return (turning + moving) / 2 + 9.81 * robot.link_masses @ poses[:, 2, 3]

    angles, rates, accelerations = np.random.default_rng(0).normal(size=(3, 7, 10))
    torques = tape(angles, rates, accelerations)
    for k in range(10):
        point, velocity = (angles[:, k], rates[:, k]), (rates[:, k], accelerations[:, k])
        change = jax.jvp(energy, point, velocity)[1]
        assert rates[:, k] @ torques[:, k] == pytest.approx(float(change), rel=1e-10, abs=1e-9)


def test_a_floating_base_is_a_pose_without_quaternions():
    from frax.assets import G1_ASSETS_DIR
    from frax.core.robot import Robot

    robot = Robot(G1_ASSETS_DIR / "g1_29dof_rev_1_0.urdf", floating_base="quaternion")
    rng = np.random.default_rng(1)
    joints, (v, a) = rng.normal(size=robot.nv - 6), rng.normal(size=(2, robot.nv))
    turn = Rotation.random(rng=rng)
    R = SE(3).pose(turn.as_matrix(), np.ones(3))[:3, :3]

    def in_base(x):
        return np.r_[R.T @ x[:3], x[3:]]

    rnea = jax.jit(lambda *x: robot.rnea(*x, None))
    there = rnea(np.r_[1, 1, 1, turn.as_quat(scalar_first=True), joints], v, a, G)
    here = rnea(np.r_[0, 0, 0, 1, 0, 0, 0, joints], in_base(v), in_base(a), in_base(np.asarray(G)))
    assert in_base(np.asarray(there)) == pytest.approx(np.asarray(here), rel=1e-9, abs=1e-8)
