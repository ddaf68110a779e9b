"""A robot of your own, from the MJCF file of its arm to a solved episode: a UR5e with a gripper on a mobile base."""

from pathlib import Path

import gymnasium as gym
import mujoco
from mujoco import mjtGeom, mjtJoint

import clutter_env  # noqa: F401  registers the environments
from assets import RobotSpec
from planners import TampExpert

FOLDER = Path(__file__).parent
BASE = ("base_x", "base_y", "base_yaw")
ARM = ("arm_shoulder_pan", "arm_shoulder_lift", "arm_elbow", "arm_wrist_1", "arm_wrist_2", "arm_wrist_3")
FINGERS = ("left_finger", "right_finger")
SLIDE, HINGE, BOX, CYLINDER = mjtJoint.mjJNT_SLIDE, mjtJoint.mjJNT_HINGE, mjtGeom.mjGEOM_BOX, mjtGeom.mjGEOM_CYLINDER


def build(file: Path) -> None:
    """Write the MJCF of the robot: base and lift, the arm on it, fingers at its end, a motor for each joint."""
    robot = mujoco.MjSpec()
    robot.modelname, robot.compiler.degree, robot.compiler.autolimits = "ur5e_mobile", False, True
    base = robot.worldbody.add_body(name="mobile_base", mass=60, inertia=[2, 2, 2], explicitinertial=True)
    for name, kind, axis in zip(BASE, (SLIDE, SLIDE, HINGE), ([1, 0, 0], [0, 1, 0], [0, 0, 1]), strict=True):
        base.add_joint(name=name, type=kind, axis=axis)
    base.add_geom(name="wheels", type=CYLINDER, size=[0.27, 0.15, 0], pos=[0, 0, 0.19])
    base.add_geom(name="column", type=CYLINDER, size=[0.1, 0.18, 0], pos=[0.15, 0, 0.5])
    lift = base.add_body(name="lift", pos=[0.15, 0, 0.75], mass=5, inertia=[0.1, 0.1, 0.1], explicitinertial=True)
    lift.add_joint(name="lift", type=SLIDE, axis=[0, 0, 1], range=[0, 0.4], armature=1, damping=[50, 0, 0])
    lift.add_geom(name="pillar", type=CYLINDER, size=[0.08, 0.2, 0], pos=[0, 0, -0.2])
    arm = mujoco.MjSpec.from_file(str(FOLDER / "ur5e.xml"))
    lift.add_frame().attach_body(arm.body("base"), "arm_", "")
    wrist = robot.body("arm_wrist_3")
    wrist.add_geom(name="palm", type=BOX, size=[0.03, 0.06, 0.03], pos=[0, 0, 0.15], mass=0.6)
    wrist.add_site(name="grip", pos=[0, 0, 0.24], quat=[0.5**0.5, 0, -(0.5**0.5), 0])
    for name, side in zip(FINGERS, (1, -1), strict=True):
        finger = wrist.add_body(name=name, pos=[0, 0, 0.22], mass=0.1, inertia=[1e-4] * 3, explicitinertial=True)
        finger.add_joint(name=name, type=SLIDE, axis=[0, side, 0], range=[0, 0.045], armature=1, damping=[20, 0, 0])
        pad = finger.add_geom(name=name, type=BOX, size=[0.012, 0.006, 0.035], pos=[0, 0.006 * side, 0])
        pad.condim, pad.friction, pad.priority, pad.solref = 4, [1, 0.02, 0.0005], 1, [0.004, 1]
        pad.solimp[:3] = 0.95, 0.99, 0.001
    coupling = robot.add_equality(type=mujoco.mjtEq.mjEQ_JOINT, name1=FINGERS[0], name2=FINGERS[1])
    coupling.data[1], coupling.solref = 1, [0.004, 1]
    for body in robot.bodies[1:]:
        body.gravcomp = 1
    for geom in robot.geoms:
        geom.contype, geom.conaffinity = 2, 0
    gains = {**dict.fromkeys(BASE, 20000), "lift": 20000, **dict.fromkeys(ARM, 2500), **dict.fromkeys(FINGERS, 2000)}
    for name, gain in gains.items():
        joint = robot.joint(name)
        if name in ARM:
            joint.armature, joint.damping = 0.1, [2, 0, 0]
        motor = robot.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        motor.set_to_position(kp=gain, dampratio=1)
        motor.forcerange, motor.forcelimited = ([-60, 60] if name in FINGERS else [-1000, 1000]), True
    robot.compile()
    file.write_text(robot.to_xml())


def read(file: Path) -> RobotSpec:
    """The robot's data: what the file does not say."""
    home = (0.25, 2.6971, -1.372973, 2.419436, -1.046463, 1.126304, -1.570796)
    return RobotSpec.from_mjcf(file, base_joints=BASE, tip="grip", finger_joints=FINGERS, home=home)


if __name__ == "__main__":
    build(FOLDER / "ur5e_mobile.xml")
    env = gym.make("clutter_env/Retrieve-o5-v0", robot=read(FOLDER / "ur5e_mobile.xml"))
    observation, info = env.reset(seed=0)
    expert, is_over = TampExpert(env), False
    expert.reset()
    while not (is_over or expert.done):
        observation, reward, terminated, truncated, info = env.step(expert.act())
        is_over = terminated or truncated
    print(f"{info['target']}: {'solved' if info['is_success'] else expert.report}")
