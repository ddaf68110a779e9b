"""robosuite's environments for another process: one JSON object a line comes in, one goes out.

It runs where `robosuite` is installed and imports nothing of this project. What the environments print goes to standard
error.
"""

import json
import os
import sys
import traceback
from typing import Any

ANSWERS = os.fdopen(os.dup(1), "w")
os.dup2(2, 1)
os.environ.setdefault("MUJOCO_GL", "egl")  # nothing is drawn, but it is imported

import numpy as np  # noqa: E402  the lines above come first
import robosuite  # noqa: E402


class Task:
    """One environment, with the controller and the limits that robosuite gives it."""

    def __init__(self) -> None:
        self.env: Any = None

    def reset(self, id: str, robot: str, seed: int) -> dict[str, Any]:
        """A new episode: the model and its robot as MJCF text, addresses of joints, and what a plan needs to know."""
        settings = {"has_renderer": False, "has_offscreen_renderer": False, "use_camera_obs": False}
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
        """One step of the environment: of the arm and, last, its gripper; a mobile base stands still."""
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


def main() -> None:
    """Answer until the input ends."""
    task = Task()
    for line in sys.stdin:
        request = json.loads(line)
        try:
            answer = getattr(task, request.pop("call"))(**request)
        except Exception:
            answer = {"error": traceback.format_exc()}
        print(json.dumps(answer), file=ANSWERS, flush=True)


if __name__ == "__main__":
    main()
