"""robosuite's environments for another process, by `answer.py`, where `robosuite` is installed."""

import os
from typing import Any

os.environ.setdefault("MUJOCO_GL", "egl")  # nothing is drawn, but it is imported

import numpy as np
import robosuite


class Worker:
    """One environment, with the controller and the limits that robosuite gives it."""

    def __init__(self) -> None:
        self.env: Any = None

    def reset(self, id: str, robot: str, seed: int, options: dict[str, Any]) -> dict[str, Any]:
        """A new episode: the model and its robot as MJCF text, addresses of joints, and what a plan needs to know.

        The `options` are those of the task, such as `use_latch` of Door.
        """
        settings = {"has_renderer": False, "has_offscreen_renderer": False, "use_camera_obs": False, **options}
        if self.env is not None:
            self.env.close()
        self.env = env = robosuite.make(id, robots=robot, seed=seed, ignore_done=False, **settings)
        env.reset()
        sim, model = env.sim, env.robots[0].robot_model
        controller = env.robots[0].part_controllers["right"]
        joints = [sim.model.joint_id2name(i) for i in range(sim.model.njnt)]
        return {
            "xml": sim.model.get_xml(),
            "root": model.root_body,
            "home": env.robots[0].init_qpos.tolist(),
            "base": controller.origin_pos.tolist(),
            "joints": {name: int(np.ravel(sim.model.get_joint_qpos_addr(name))[0]) for name in joints},
            "arm": env.robots[0].robot_arm_joints,
            "fingers": env.robots[0].gripper_joints["right"],
            "most": controller.output_max.tolist(),
            "stiffness": float(controller.kp[0]),
            "lag": float(controller.kd[0] / controller.kp[0]),
            "strength": controller.actuator_max.tolist(),
            "site": controller.ref_name,
            "elbow": controller.initial_joint.tolist(),
            "horizon": env.horizon,
            **self.state(),
        }

    def step(self, action: list[float]) -> dict[str, Any]:
        """Do one step of the environment, of the arm and, last, its gripper. A mobile base stands still."""
        parts = {"right": np.array(action[:-1]), "right_gripper": np.array(action[-1:])}
        self.env.step(self.env.robots[0].create_action_vector(parts))
        return self.state()

    def state(self) -> dict[str, Any]:
        """Joint positions, and what the environment says: whether its goal is reached, and whether time is up."""
        return {
            "qpos": self.env.sim.data.qpos.tolist(),
            "is_success": bool(self.env._check_success()),
            "done": bool(self.env.done),
        }
