"""KinDER's environments for another process, by `answer.py`, where `kindergarden` is installed."""

import os
import re
from pathlib import Path
from typing import Any

os.environ.setdefault("DISPLAY", ":99")  # without one, KinDER forces a renderer that may not be there
os.environ.setdefault("MUJOCO_GL", "egl")
os.environ.setdefault("DISABLE_AUTO_DYNAMIC3D_SCENES_DOWNLOAD", "1")

import kinder
import mujoco
import numpy as np

kinder.register_all_environments()
_ROBOTS = {"tidybot": "stanford_tidybot/tidybot.xml", "fr3": "franka_fr3/fr3.xml"}


class Worker:
    """One environment."""

    def __init__(self) -> None:
        self.env: Any = None
        self.id = ""

    def reset(self, id: str, seed: int) -> dict[str, Any]:
        """A new episode: the model as MJCF text, addresses of joints, the task's goal and the boxes of its regions."""
        if id != self.id:
            self.env, self.id = kinder.make(id), id
        self.env.reset(seed=seed)
        task = self.task
        model = task._robot_env.sim.model.mj_model
        file = Path(f"/tmp/kinder-{os.getpid()}.xml")
        mujoco.mj_saveLastXML(str(file), model)
        text = file.read_text()
        file.unlink()
        models = Path(kinder.__file__).parent / "envs/dynamic3d/models"
        file = models / _ROBOTS[task.robot_type]
        owners = {"ground": task._ground_fixture, **task._fixtures_dict, **task._objects_dict}
        wanted = {fact[2] for fact in task.task_config["goal_state"] if len(fact) == 3 and fact[0] in ("on", "in")}
        boxes, anchors = {}, {}
        for name in wanted:
            owner = anchors[name] = task.task_config["regions"][name]["target"]
            regions = owners[owner].region_objects[name]
            for region in regions:
                region.env = task._robot_env
            boxes[name] = [[float(value) for value in region.bbox] for region in regions]
        joints = {model.joint(i).name: int(model.jnt_qposadr[i]) for i in range(model.njnt)}
        return {
            "xml": text,
            "joints": joints,
            "kind": task.robot_type,
            "robot": re.sub('meshdir="[^"]*"', f'meshdir="{models / "assets"}"', file.read_text()),
            "base": list(task._robot_env.get_base_pos_yaw()) if task.robot_type == "fr3" else [],
            "goal": task.task_config["goal_state"],
            "boxes": boxes,
            "anchors": anchors,
            **self.state(False, False),
        }

    def step(self, action: list[float]) -> dict[str, Any]:
        """One step of the environment."""
        space = self.env.action_space
        _, _, terminated, truncated, _ = self.env.step(
            np.clip(np.array(action, dtype=np.float32), space.low, space.high)
        )
        return self.state(terminated, truncated)

    def state(self, terminated: bool, truncated: bool) -> dict[str, Any]:
        """Joint positions, and whether the environment says that its goal is reached."""
        qpos = self.task._robot_env.sim.data.mj_data.qpos
        return {"qpos": qpos.tolist(), "terminated": bool(terminated), "truncated": bool(truncated)}

    @property
    def task(self) -> Any:
        """The environment inside its wrappers."""
        return self.env.unwrapped._object_centric_env
