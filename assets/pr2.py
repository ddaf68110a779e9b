"""PR2: holonomic base, torso lift, two arms. Names, geometry and limits are those of the manufacturer's URDF.

The base's origin is on the floor. The torso takes 25 s for its stroke, so plans do not move it.
"""

from __future__ import annotations

import math

from assets.robot_parts import ARM_FIELDS, NO_TURN, ArmSpec, ChainLink, LinkMesh
from assets.robot_spec import RobotSpec

_GREY = (0.45, 0.46, 0.48, 1.0)
_WHITE = (0.92, 0.92, 0.90, 1.0)
_BLACK = (0.20, 0.20, 0.22, 1.0)
_ROBOT, _GRIPPER = "robots/pr2/meshes", "grippers/meshes/pr2_gripper"

_HALF_SIDE = 0.334
"""[m] Half side of the square base."""
_TURN = 2 * math.pi
_VELOCITY = (2.09, 2.08, 3.27, 3.3, 3.6, 3.08, 3.6)
_ACCELERATION = (1.5, 1.5, 2.0, 2.0, 2.5, 2.5, 2.5)

_ARM_MESHES = (
    ("shoulder_pan_link", "shoulder_v0/shoulder_pan.stl", _WHITE),
    ("shoulder_lift_link", "shoulder_v0/shoulder_lift.stl", _GREY),
    ("upper_arm_roll_link", "shoulder_v0/upper_arm_roll.stl", _GREY),
    ("upper_arm_roll_link", "upper_arm_v0/upper_arm.stl", _WHITE),
    ("elbow_flex_link", "upper_arm_v0/elbow_flex.stl", _GREY),
    ("forearm_roll_link", "upper_arm_v0/forearm_roll.stl", _GREY),
    ("forearm_roll_link", "forearm_v0/forearm.stl", _WHITE),
    ("wrist_flex_link", "forearm_v0/wrist_flex.stl", _GREY),
    ("wrist_roll_link", "forearm_v0/wrist_roll.stl", _GREY),
)


def _home(left: int) -> tuple[float, ...]:
    """Home configuration: elbow out and high, forearm folded inwards, gripper level, ahead and 1.1 m above the floor.

    The left arm (1) is the mirror image of the right arm (-1).
    """
    return (0.74 * left, -0.1822, 1.4652 * left, -2.2878, 2.936 * left, -1.5532, 1.5298 * left)


def _arm(name: str, left: int) -> ArmSpec:
    s = name[0]
    pan = (-0.7146, 2.2854) if left > 0 else (-2.2854, 0.7146)
    roll = (-0.8, 3.9) if left > 0 else (-3.9, 0.8)
    return ArmSpec(
        name=name,
        chain=(
            ChainLink(f"{s}_shoulder_pan_joint", (0.0, 0.188 * left, 0.0), "z", *pan),
            ChainLink(f"{s}_shoulder_lift_joint", (0.1, 0.0, 0.0), "y", -0.5236, 1.3963),
            ChainLink(f"{s}_upper_arm_roll_joint", (0.0, 0.0, 0.0), "x", *roll),
            ChainLink(f"{s}_elbow_flex_joint", (0.4, 0.0, 0.0), "y", -2.3213, 0.0),
            ChainLink(f"{s}_forearm_roll_joint", (0.0, 0.0, 0.0), "x", -_TURN, _TURN),
            ChainLink(f"{s}_wrist_flex_joint", (0.321, 0.0, 0.0), "y", -2.18, 0.0),
            ChainLink(f"{s}_wrist_roll_joint", (0.0, 0.0, 0.0), "x", -_TURN, _TURN),
        ),
        tcp_offset=(0.18, 0.0, 0.0),
        tcp_quaternion=NO_TURN,
        tcp_site=f"{s}_tcp",
        gripper_body=f"{s}_gripper_palm_link",
        finger_joints=(f"{s}_gripper_l_finger_joint", f"{s}_gripper_r_finger_joint"),
        finger_geoms=(f"{s}_l_finger", f"{s}_r_finger"),
        home=_home(left),
        max_velocity=_VELOCITY,
        max_acceleration=_ACCELERATION,
    )


def _meshes() -> tuple[LinkMesh, ...]:
    body = (
        LinkMesh("base_footprint", f"{_ROBOT}/base_v0/base.stl", _WHITE, (0.0, 0.0, 0.051)),
        LinkMesh("torso_lift_link", f"{_ROBOT}/torso_v0/torso_lift.stl", _GREY),
        LinkMesh("head_pan_link", f"{_ROBOT}/head_v0/head_pan.stl", _GREY),
        LinkMesh("head_tilt_link", f"{_ROBOT}/head_v0/head_tilt.stl", _WHITE),
    )
    arms = (LinkMesh(f"{s}_{link}", f"{_ROBOT}/{file}", rgba) for s in "rl" for link, file, rgba in _ARM_MESHES)
    return (*body, *arms, *(mesh for s in "rl" for mesh in _gripper_meshes(s)))


def _gripper_meshes(s: str) -> tuple[LinkMesh, ...]:
    """Palm and fingers. The right finger is the left finger turned about the approach."""
    palm = LinkMesh(f"{s}_gripper_palm_link", f"{_GRIPPER}/gripper_palm.stl", _GREY)
    fingers = (
        LinkMesh(f"{s}_gripper_{side}_finger_link", f"{_GRIPPER}/{file}.stl", _BLACK, (x, y * left, 0.0), turn)
        for side, left, turn in (("l", 1, NO_TURN), ("r", -1, (0.0, 1.0, 0.0, 0.0)))
        for file, x, y in (("l_finger", -0.08509, -0.001), ("l_finger_tip", 0.00628, 0.00395))
    )
    return (palm, *fingers)


_RIGHT, _LEFT = _arm("right", -1), _arm("left", 1)

PR2 = RobotSpec(
    name="pr2",
    mjcf="mjcf/pr2.xml",
    base_body="base_footprint",
    base_joints=("base_x", "base_y", "base_yaw"),
    chain=(
        ChainLink("torso_lift_joint", (-0.05, 0.0, 0.790675), "z", 0.0, 0.33, prismatic=True),
        *_RIGHT.chain,
    ),
    **{name: getattr(_RIGHT, name) for name in ARM_FIELDS},
    head_joints=("head_pan_joint", "head_tilt_joint"),
    head_configuration=(0.0, 0.75),
    cameras=("head", "r_gripper", "l_gripper"),
    home=(0.25, *_RIGHT.home),
    max_velocity=(1.0, 1.0, 1.5, 0.013, *_VELOCITY),
    max_acceleration=(1.0, 1.0, 2.0, 0.1, *_ACCELERATION),
    max_loaded_yaw_rate=0.6,
    max_tcp_velocity=(0.3, 1.0),
    max_finger_velocity=0.05,
    max_finger_position=0.044,
    finger_gap_closed=0.002,
    finger_thickness=0.02,
    grasp_height=0.065,
    grasp_axis_offset=0.0,
    base_radius=_HALF_SIDE * math.sqrt(2.0),
    base_height=0.707,
    meshes=_meshes(),
    mesh_package="robosuite_models",
    mesh_folder="assets",
    base_outline=tuple((x * _HALF_SIDE, y * _HALF_SIDE) for x, y in ((1, 1), (-1, 1), (-1, -1), (1, -1))),
    arm_name="right",
    idle_arms=(_LEFT,),
    plans_torso=False,
)
"""PR2 with its right arm active. `PR2.using("left")` has the other arm active."""
