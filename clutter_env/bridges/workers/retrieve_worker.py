"""`Retrieve` for another process, by `answer.py`, where this package is installed: states as numbers with names."""

import base64
import os
from typing import Any

if not os.environ.get("DISPLAY"):  # KinDER then asks for OSMesa, without looking whether it is there
    for name in ("MUJOCO_GL", "PYOPENGL_PLATFORM"):
        os.environ.pop(name, None)

import mujoco
import numpy as np

from assets import ActingJoints
from clutter_env.envs.retrieve import RetrieveEnv
from clutter_env.envs.success import HOLD_STEPS
from clutter_env.errors import ConfigError
from clutter_env.scene.layout import furniture
from clutter_env.simulation.control import STILL

_POSE = ["x", "y", "z", "qw", "qx", "qy", "qz"]
_VELOCITY = ["vx", "vy", "vz", "wx", "wy", "wz"]
_SIZE = ["bb_x", "bb_y", "bb_z"]
_PRESSING = ["furniture_force", "furniture_impulse", "self_force", "self_impulse", "total_slide"]


class Worker:
    """One environment. A state is a dictionary of objects by type and name, each a list of numbers."""

    env: RetrieveEnv
    expert: Any = None

    def make(self, keywords: dict[str, Any]) -> dict[str, Any]:
        """Build it: names of the features by type, of the numbers of an action, and the furniture."""
        if {"obs_mode", "reality"} & keywords.keys():
            raise ConfigError("obs_mode and reality are about what the robot sees; states are exact and complete")
        self.env = env = RetrieveEnv(render_mode="rgb_array", **keywords)
        acting, controller = ActingJoints.of(env.robot), env.world.controller
        drive = ["base_x", "base_y", "base_rot", "torso"]
        drive += [f"arm_joint{number}" for number in range(1, len(acting.names) - 3)]
        grippers = ["gripper", *(f"gripper{number}" for number in range(2, controller.num_grippers + 1))]
        base = [name for i, name in enumerate(("forward", "left", "yaw rate")) if i not in STILL[env.robot.base_drive]]
        moves = [f"{kind} velocity of the TCP along {axis}" for kind in ("linear", "angular") for axis in "xyz"]
        own = moves if env.control_mode == "ee" else [f"rate of {name}" for name in acting.names[3:]]
        return {
            "features": {
                "clutter_robot": [
                    *(f"pos_{name}" for name in (*drive, *grippers)),
                    *(f"vel_{name}" for name in drive),
                    *(f"command_{name}" for name in grippers),
                    *(f"tcp_{name}" for name in _POSE),
                    *("lift", "hold_progress", *_PRESSING, "total_path"),
                ],
                "clutter_object": [*_POSE, *_VELOCITY, *_SIZE, "is_target", "is_box", "is_held", "is_fallen", "path"],
                "clutter_furniture": [*_POSE, *_SIZE],
            },
            "actions": [*(f"base {name}" for name in base), *own, *(f"opening of the {name}" for name in grippers)],
            "furniture": {
                box.name: [*box.position, 1.0, 0.0, 0.0, 0.0, *(2 * half for half in box.half_extents)]
                for box in furniture(env.layout)
            },
        }

    def reset(self, seed: int | None, options: dict[str, Any] | None) -> dict[str, Any]:
        """Start an episode."""
        self.expert = None
        self.env.reset(seed=seed, options=options)
        return self._state(saved=True)

    def step(self, action: list[float], saved: bool) -> dict[str, Any]:
        """Do one step. `saved` says whether the state is to be restored later."""
        _, reward, terminated, truncated, _ = self.env.step(np.array(action, np.float32))
        return {"reward": reward, "terminated": terminated, "truncated": truncated, **self._state(saved)}

    def restore(self, saved: str) -> dict[str, Any]:
        """Continue from a saved state, bit for bit."""
        self.expert = None
        self.env.restore_state(base64.b64decode(saved))
        return self._state(saved=False)

    def act(self) -> dict[str, Any]:
        """The expert's next action, null after it has given up. The first call plans."""
        if self.expert is None:
            from planners import TampExpert  # which takes longer to import than all else here

            self.expert = TampExpert(self.env)
            self.expert.reset()
        return {"action": None if self.expert.done else self.expert.act().tolist()}

    def render(self) -> dict[str, Any]:
        """The image of the present state."""
        image = np.asarray(self.env.render())
        return {"shape": image.shape, "pixels": base64.b64encode(image.tobytes()).decode()}

    def _state(self, saved: bool) -> dict[str, Any]:
        env, data, index, robot = self.env, self.env.data, self.env.world.index, self.env.robot
        monitor, measured, scene = env._monitor, env.measurements, env.world.scene
        past, info = monitor.memory(), env.info
        fingers = data.qpos[index.finger_qpos].reshape(-1, 2).sum(axis=1) / 2
        commanded = np.array(env.world.controller.state.fingers)
        quaternion = np.empty(4)
        mujoco.mju_mat2Quat(quaternion, data.site_xmat[index.tcp_site])
        slots = np.arange(scene.num_objects)
        numbers = (
            measured.poses,
            data.qvel[index.object_dof].reshape(-1, 6),
            2 * scene.half_extents,
            slots == env.target_slot,
            scene.is_box,
            np.isin(slots, measured.grip.held),
            past["is_fallen"],
            past["paths"],
        )
        own = (
            data.qpos[index.drive_qpos],
            1 - fingers / robot.max_finger_position,
            data.qvel[index.drive_dof],
            1 - commanded / robot.max_finger_position,
            data.site_xpos[index.tcp_site],
            quaternion,
            (monitor.lift, min(monitor.steps_held / HOLD_STEPS, 1.0)),
            [info[name] for name in (*_PRESSING, "total_path")],
        )
        objects = dict(zip(env.object_names, np.column_stack(numbers).tolist(), strict=True))
        return {
            "state": {"clutter_robot": {"robot": np.concatenate(own).tolist()}, "clutter_object": objects},
            "info": info,
            "saved": base64.b64encode(env.save_state()).decode() if saved else "",
        }
