"""The circle that contains the robot at the heights of an obstacle, against MuJoCo's distances."""

import mujoco
import numpy as np
import pytest

from assets.robots import FETCH
from irm.robot_shape import robot_radius

BANDS = [(0.0, 0.7), (0.0, 0.3), (0.36, 0.82), (0.9, 1.2)]


@pytest.fixture(scope="module")
def deepest():
    """Largest penetration [m] of base, torso and head with a box of the given heights, over turns and torso heights."""
    arm = set()

    def measure(gap, low, high):
        spec = mujoco.MjSpec.from_file(str(FETCH.mjcf_path))
        box = spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, name="obstacle")
        box.size, box.pos = [0.5, 1.0, (high - low) / 2], [0.5 + gap, 0.0, (low + high) / 2]
        model = spec.compile()
        data = mujoco.MjData(model)
        first_arm_body = model.joint(FETCH.arm_joints[0]).bodyid[0]
        arm.clear()
        for body in range(model.nbody):
            if body == first_arm_body or model.body_parentid[body] in arm:
                arm.add(body)
        trunk = [g for g in range(model.ngeom) if model.geom_bodyid[g] and model.geom_bodyid[g] not in arm]
        trunk = [g for g in trunk if model.geom_contype[g] or model.geom_conaffinity[g]]
        worst = np.inf
        for yaw in np.linspace(-np.pi, np.pi, 181):
            for torso in np.linspace(FETCH.chain[0].lower, FETCH.chain[0].upper, 5):
                data.qpos[model.joint(FETCH.base_joints[2]).qposadr[0]] = yaw
                data.qpos[model.joint(FETCH.torso_joint).qposadr[0]] = torso
                mujoco.mj_forward(model, data)
                apart = [mujoco.mj_geomDistance(model, data, g, model.geom("obstacle").id, 0.2, None) for g in trunk]
                worst = min(worst, *apart)
        return -worst

    return measure


@pytest.mark.parametrize(("low", "high"), BANDS)
def test_a_base_outside_the_radius_touches_nothing_and_the_radius_is_not_larger_than_needed(deepest, low, high):
    radius = robot_radius(FETCH, low, high)
    assert deepest(radius + 0.001, low, high) <= 0.0
    assert deepest(radius - 0.006, low, high) > 0.0


def test_the_torso_extends_farther_than_the_base():
    assert robot_radius(FETCH, 0.0, 0.3) < robot_radius(FETCH, 0.36, 0.82) == robot_radius(FETCH)
    assert robot_radius(FETCH, 0.0, 0.3) == pytest.approx(FETCH.base_radius, rel=0.005)
    assert robot_radius(FETCH) > FETCH.base_radius + 0.02
    assert robot_radius(FETCH, 3.0, 4.0) == 0.0


BAD_FLOORS = [
    ({"radius": "wide"}, "radius"),
    ({"radius": None}, "radius"),
    ({"radius": -0.1}, "radius"),
    ({"radius": 0.3, "bounds": (1, 2)}, "bounds"),
    ({"radius": 0.3, "bounds": 5}, "bounds"),
    ({"radius": 0.3, "resolution": None}, "resolution"),
    ({"radius": 0.3, "resolution": 1e-9}, "too many"),
]
