"""`Retrieve` among KinDER's environments, to be imported where `kindergarden` is installed.

KinDER needs other versions of MuJoCo and NumPy than this package: the physics run in a process of another interpreter.
Here nothing is needed beside KinDER and the files of this package.

    import kinder
    from clutter_env.bridges import for_kinder

    for_kinder.register("venv-clutter/bin/python")
    env = kinder.make("kinder/ClutteredRetrieval3D-o15-v0")
"""

from __future__ import annotations

import base64
import shutil
from pathlib import Path
from typing import Any

import gymnasium as gym
import kinder
import numpy as np
from kinder.core import ConstantObjectKinDEREnv, KinDEREnvConfig, ObjectCentricKinDEREnv
from kinder.envs.dynamic3d.object_types import MujocoFixtureObjectType, MujocoMovableObjectType
from kinder.envs.utils import RobotActionSpace
from numpy.typing import NDArray
from relational_structs import Object, ObjectCentricState, ObjectCentricStateSpace, Type

from clutter_env import time_limit
from clutter_env.bridges.remote import BridgeError, Remote

Array = NDArray[Any]

NAME = "ClutteredRetrieval3D"
VARIANTS: dict[str, dict[str, Any]] = {
    **{f"o{count}": {"num_objects": count} for count in (1, 5, 15, 25, 40)},
    **{f"o{count}-obstructed": {"num_objects": count, "obstructed": True} for count in (5, 15, 25, 40)},
    **{f"o{count}-shelf": {"num_objects": count, "layout": "shelf"} for count in (5, 10, 16)},
}
"""Keyword arguments of `Retrieve` by what stands in the id after the name."""
_PARENTS = {"clutter_object": MujocoMovableObjectType, "clutter_furniture": MujocoFixtureObjectType}
_FPS = 20
_KEPT = 10_000
_saved: dict[bytes, str] = {}
"""Saved states that restore the last states which environments of this process have shown, by their numbers."""


def register(python: str | Path) -> None:
    """Add the environments to Gymnasium's registry and KinDER's list. `python` has this package with all it needs."""
    python = Path(shutil.which(python) or python).absolute()  # programs that use KinDER change their folder
    ids = {f"kinder/{NAME}-{variant}-v0": keywords for variant, keywords in VARIANTS.items()}
    entry_point = f"{__name__}:{ClutteredRetrieval3DEnv.__name__}"
    for id, keywords in ids.items():
        gym.register(
            id=id,
            entry_point=entry_point,
            kwargs={"python": str(python), **keywords},
            max_episode_steps=time_limit(keywords["num_objects"]),
        )
    # Not KinDER's backend "mujoco", for which it would download scenes.
    kinder.ENV_CLASSES[NAME] = {
        "entry_point": entry_point,
        "category": "Dynamic3D",
        "backend": "clutter-env",
        "variants": list(ids),
    }


class _ActionSpace(RobotActionSpace):
    """Numbers from -1 to 1 with names."""

    def __init__(self, names: list[str]) -> None:
        super().__init__(np.full(len(names), -1.0), np.full(len(names), 1.0))
        self._names = names

    def create_markdown_description(self) -> str:
        """A table of the numbers."""
        rows = "".join(f"\n| {index} | {name} |" for index, name in enumerate(self._names))
        return (
            "For 0.05 s, shares of the robot's largest velocities, from -1 to 1, those of the base along its own axes; "
            f"of a gripper, -1 is closed and 1 open.\n\n| **Index** | **Meaning** |\n| --- | --- |{rows}\n"
        )


class ObjectCentricClutteredRetrieval3DEnv(ObjectCentricKinDEREnv):
    """`Retrieve` with object-centric states. Keyword arguments and reset options are those of `Retrieve`.

    Reset takes `init_state` too, as `set_state` does. It restores bit for bit a state that an environment of this
    process has shown, at a reset or, with `allow_state_access`, at any step. Any other is refused.

    Raises:
        BridgeError: the interpreter cannot be used, or `Retrieve` has raised something.
    """

    def __init__(
        self,
        python: str,
        render_mode: str | None = "rgb_array",
        allow_state_access: bool = False,
        **keywords: Any,
    ) -> None:
        self._own_reward = "reward_mode" in keywords
        self._remote = Remote(python, "retrieve_worker.py")
        self._made = self._remote("make", keywords=keywords)
        self._types = {name: Type(name, _PARENTS.get(name)) for name in self._made["features"]}
        self._features = {self._types[name]: features for name, features in self._made["features"].items()}
        self._known: dict[str, Object] = {}
        self._furniture = self._objects({"clutter_furniture": self._made["furniture"]})
        self._state: ObjectCentricState | None = None
        super().__init__(KinDEREnvConfig(render_fps=_FPS), render_mode, allow_state_access)

    @property
    def type_features(self) -> dict[Type, list[str]]:
        """Types, and the names of their numbers."""
        return self._features

    def _create_constant_initial_state(self) -> ObjectCentricState:
        return ObjectCentricState(dict(self._furniture), self._features)

    def _create_observation_space(self, config: KinDEREnvConfig) -> ObjectCentricStateSpace:  # noqa: ARG002  KinDER's
        return ObjectCentricStateSpace(set(self._features))

    def _create_action_space(self, config: KinDEREnvConfig) -> RobotActionSpace:  # noqa: ARG002  KinDER's
        return _ActionSpace(self._made["actions"])

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[ObjectCentricState, dict[str, Any]]:
        """Start an episode."""
        if options and "init_state" in options:
            return self._restored(options["init_state"])
        answer = self._remote("reset", seed=seed, options=options)
        return self._shown(answer), answer["info"]

    def step(self, action: Array) -> tuple[ObjectCentricState, float, bool, bool, dict[str, Any]]:
        """Do one control step. Terminated means success, truncated that success is no longer possible."""
        answer = self._remote("step", action=np.asarray(action).tolist(), saved=self._allow_state_access)
        is_success = answer["info"]["is_success"]
        truncated = answer["truncated"] or (answer["terminated"] and not is_success)
        reward = answer["reward"] if self._own_reward else -1.0
        return self._shown(answer), reward, is_success, truncated, answer["info"]

    def expert_action(self) -> Array | None:
        """The next action of clutter-env's planner, None after it has given up. The first call plans.

        It knows all poses exactly. For demonstrations.
        """
        action = self._remote("act")["action"]
        return None if action is None else np.array(action, np.float32)

    def render(self) -> NDArray[np.uint8]:
        """The scene from the side, (height, width, 3)."""
        answer = self._remote("render")
        return np.frombuffer(base64.b64decode(answer["pixels"]), np.uint8).reshape(answer["shape"]).copy()

    def close(self) -> None:
        """End the process."""
        self._remote.close()

    def _get_state(self) -> ObjectCentricState:
        assert self._state is not None, "call reset() first"
        return self._state.copy()

    def _set_state(self, state: ObjectCentricState) -> None:
        self._restored(state)

    def _restored(self, state: ObjectCentricState) -> tuple[ObjectCentricState, dict[str, Any]]:
        saved = _saved.get(_key(state))
        if saved is None:
            raise BridgeError(
                "no environment of this process has shown this state, at a reset or, with allow_state_access=True, at "
                f"a step, among the last {_KEPT}; poses and velocities alone do not say what the controller, the "
                "contacts and the rule of success go on from"
            )
        answer = self._remote("restore", saved=saved) | {"saved": saved}
        return self._shown(answer), answer["info"]

    def _shown(self, answer: dict[str, Any]) -> ObjectCentricState:
        """The state in an answer. The bytes that restore it are kept."""
        self._state = ObjectCentricState({**self._objects(answer["state"]), **self._furniture}, self._features)
        if answer["saved"]:
            key = _key(self._state)
            _saved.pop(key, None)
            _saved[key] = answer["saved"]
            while len(_saved) > _KEPT:
                del _saved[next(iter(_saved))]
        return self._state.copy()

    def _objects(self, state: dict[str, dict[str, list[float]]]) -> dict[Object, Array]:
        found = {}
        for kind, each in state.items():
            for name, numbers in each.items():
                if name not in self._known:  # KinDER computes a digest for each new one
                    self._known[name] = Object(name, self._types[kind])
                found[self._known[name]] = np.array(numbers)
        return found


def _key(state: ObjectCentricState) -> bytes:
    """The numbers of a state, rounded as in a vector."""
    return bytes(state.vec(sorted(state.data)).tobytes())


class ClutteredRetrieval3DEnv(ConstantObjectKinDEREnv):
    """`Retrieve` with vectors of a constant set of objects. See `ObjectCentricClutteredRetrieval3DEnv`."""

    def _create_object_centric_env(self, *args: Any, **keywords: Any) -> ObjectCentricClutteredRetrieval3DEnv:
        own = ("python", "allow_state_access")
        self._keywords = {name: value for name, value in keywords.items() if name not in own}
        return ObjectCentricClutteredRetrieval3DEnv(*args, **keywords)

    def _get_constant_object_names(self, exemplar_state: ObjectCentricState) -> list[str]:
        return [entry.name for entry in exemplar_state]

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Array, dict[str, Any]]:
        """Start an episode. Explicit scenes must have all objects of the observation space."""
        objects, wanted = (options or {}).get("objects"), self._keywords["num_objects"]
        if objects is not None and len(objects) != wanted:
            raise BridgeError(f"{len(objects)} objects do not fill an observation of {wanted}")
        return super().reset(seed=seed, options=options)

    def expert_action(self) -> Array | None:
        """See `ObjectCentricClutteredRetrieval3DEnv.expert_action`."""
        action: Array | None = self._object_centric_env.expert_action()
        return action

    def close(self) -> None:
        """End the process."""
        self._object_centric_env.close()

    def _create_env_markdown_description(self) -> str:
        return (
            "A mobile manipulator before a table full of objects must lift the target (`is_target` is 1) out of the "
            "clutter and hold it. Other objects may be put aside, carried in the gripper, but must neither fall nor be "
            "pushed.\n\nSuccess: the target has been carried with its lowest point 0.10 m above what it stood on for "
            "0.5 s (`hold_progress` is 1), no object has fallen since reset (`is_fallen`) or moved by more than 0.05 m "
            "while it was not carried (`path`), all objects but the target together no more than 0.10 m "
            "(`total_path`), and neither on furniture nor on itself has the robot pressed with more than 50 N in the "
            "mean of 0.1 s (`furniture_force`, `self_force`), or with an impulse of more than 1 N s beyond that "
            "(`furniture_impulse`, `self_impulse`), or so that a table of 10 kg would slide by more than 0.005 m in "
            "all (`total_slide`). clutter-env's Retrieve decides, and runs the physics in MuJoCo.\n"
        )

    def _create_variant_markdown_description(self) -> str:
        return (
            "The number after o counts all objects, the target among them. -obstructed: no side grasp reaches the "
            "target before something is moved. -shelf: the objects stand under a shelf.\n"
        )

    def _create_variant_specific_description(self) -> str:
        return (
            f"clutter-env's Retrieve with {', '.join(f'{name}={value!r}' for name, value in self._keywords.items())}.\n"
        )

    def _create_reward_markdown_description(self) -> str:
        return (
            "A penalty of -1.0 at every step until success, with which alone an episode terminates; it is truncated "
            "where the target has fallen off the table. With the keyword argument reward_mode it is clutter-env's.\n"
        )

    def _create_references_markdown_description(self) -> str:
        return "clutter-env, docs/retrieve.md.\n"
