"""Questions as files: JSON Lines, with an image and a segmentation mask for each camera of a scene.

`questions.jsonl` is for the model: id, images, the text, what can be answered, the answer. `scenes.jsonl` says where
everything stands: it is for baselines and for whoever checks, not for the model.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence, Set
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from clutter_env.errors import LearningError
from clutter_env.evaluation.question_balance import Asked, balanced
from clutter_env.evaluation.questions import OF_GRASPS, Asker, Question
from clutter_env.rendering.cameras import FIRST_OBJECT
from clutter_env.reporting.files import json_text, write_atomically
from clutter_env.scene.table_scene import TableScene
from planners import Scene

CAMERAS = ("top", "head")
"""Whose images are written."""
SEEN = 12
"""Pixels of an object in all images together, at least, for questions about it, or with it in the answer."""
QUESTIONS, SCENES = "questions.jsonl", "scenes.jsonl"
_DECIMALS = 3
"""Of a colour."""
_STACK_EVERY = 5
"""One of so many scenes is of blocks that stand on each other."""


@dataclass(frozen=True)
class Kind:
    """An environment for whose scenes questions are made.

    Attributes:
        env_id, keywords: of it.
        is_turned: whether the obstructed object of the scene changes roles with another one, which becomes the target.
    """

    env_id: str
    keywords: Mapping[str, Any]
    is_turned: bool = False


def kinds(objects: int) -> tuple[Kind, Kind, Kind]:
    """Cylinders on the paper's table, with the target obstructed, and with another object obstructed. Also blocks,
    three of which stand in a stack."""
    table = Kind("clutter_env/Retrieve-o5-v0", {"num_objects": objects, "obstructed": objects > 1})
    stacked = Kind("clutter_env/Rearrange-o8-v0", {"num_objects": max(objects, 3), "task": "stack"})
    return table, replace(table, is_turned=True), stacked


def scenes(objects: int, count: int, first_seed: int) -> list[tuple[Kind, int]]:
    """Kind and seed of each of some scenes. In half of those of cylinders the target is not the obstructed object: its
    colour says nothing about what can be taken."""
    table, turned, stacked = kinds(objects)
    return [
        (stacked if index % _STACK_EVERY == _STACK_EVERY - 1 else (table, turned)[index % 2], first_seed + index)
        for index in range(count)
    ]


def asked(
    env: gym.Env[Any, Any], kind: Kind, seed: int, asker: Asker
) -> tuple[Scene, str, list[Question], dict[str, Any]]:
    """The scene of a kind for a seed, its target ("" of blocks), the questions, and the observation.

    Asked about are the target and another object: the obstructed one, where that is not the target.
    """
    observation, info = env.reset(seed=seed)
    inner: Any = env.unwrapped
    rng = np.random.default_rng(seed)
    target = info["target"]
    other = str(rng.choice([name for name in inner.world.names if name != target]))
    if kind.is_turned:
        target, other = other, target
        chosen = {"objects": _described(inner.world.scene), "target": target, "obstructed": False}
        observation, _ = env.reset(seed=seed, options=chosen)
    scene = Scene.from_mujoco(inner.model, inner.data, inner.robot)
    return scene, target, asker.questions(inner, [one for one in (target, other) if one]), observation


def _described(scene: TableScene) -> list[dict[str, Any]]:
    """The upright cylinders of a scene, as the reset option `objects` wants them."""
    return [
        {
            "shape": "cylinder",
            "radius": float(half[0]),
            "height": float(2 * half[2]),
            "position": tuple(map(float, position)),
            "mass": float(mass),
        }
        for half, position, mass in zip(scene.half_extents, scene.positions, scene.masses, strict=True)
    ]


def write_questions(
    folder: Path, objects: int, count: int, first_seed: int, image_size: int, tick: Callable[[], object] = lambda: None
) -> int:
    """Write questions about scenes, with their images. `question_balance` says how many.

    Args:
        folder: of the files.
        objects: in a scene.
        count: of scenes.
        first_seed: of the scenes.
        image_size: [pixels] along each side, 0 for no images.
        tick: called after every scene.

    Raises:
        OSError: a file cannot be written.
        RenderingUnavailable: there is no OpenGL.
    """
    (folder / "images").mkdir(parents=True, exist_ok=True)
    images: dict[str, Any] = {"obs_mode": "rgbd", "segmentation": True, "cameras": CAMERAS, "image_size": image_size}
    found: list[Asked] = []
    lines: list[str] = []
    placed: list[str] = []
    asker_of: dict[str, Asker] = {}
    envs: dict[str, gym.Env[Any, Any]] = {}
    for kind, seed in scenes(objects, count, first_seed):
        if kind.env_id not in envs:
            envs[kind.env_id] = gym.make(kind.env_id, **kind.keywords, **(images if image_size else {}))
            asker_of[kind.env_id] = Asker()
        env = envs[kind.env_id]
        name = f"{kind.env_id.rpartition('/')[2].partition('-')[0].lower()}-{seed}"
        scene, target, questions, observation = asked(env, kind, seed, asker_of[kind.env_id])
        shown = _write_images(folder, name, observation) if image_size else {}
        masks = {one: FIRST_OBJECT + index for index, one in enumerate(scene.names)}
        hidden = _hidden(masks, observation) if image_size else set()
        for number, question in enumerate(questions):
            if _is_hidden(question, hidden):
                continue
            found.append(Asked(question, question.about == target, scene.body(question.about).position))
            about = {"id": f"{name}/{number}", "scene": name, **asdict(question), "images": shown, "mask_values": masks}
            lines.append(json_text(about))
        where = {"scene": name, "env_id": kind.env_id, "keywords": dict(kind.keywords), "seed": seed, "target": target}
        world: Any = env.unwrapped
        objects_at = [
            {
                "name": body.name,
                "shape": body.shape,
                "position": body.position,
                "half_extents": body.half_extents,
                "colour": world.world.colour(slot).round(_DECIMALS).tolist(),
            }
            for slot, body in enumerate(scene.objects)
        ]
        placed.append(json_text({**where, "is_turned": kind.is_turned, "objects": objects_at}))
        tick()
    for env in envs.values():
        env.close()
    kept = [lines[index] for index in balanced(found, np.random.default_rng(first_seed))]
    for file, written in ((QUESTIONS, kept), (SCENES, placed)):
        write_atomically(folder / file, "".join(f"{line}\n" for line in written).encode())
    return len(kept)


def _hidden(masks: Mapping[str, int], observation: Mapping[str, NDArray[Any]]) -> set[str]:
    """Objects of which no image shows `SEEN` pixels."""
    shown = np.zeros(256, np.int64)
    for camera in CAMERAS:
        shown += np.bincount(observation[f"{camera}_segmentation"].ravel(), minlength=256)
    return {name for name, value in masks.items() if shown[value] < SEEN}


def _is_hidden(question: Question, hidden: Set[str]) -> bool:
    """Whether an object on which the answer depends cannot be seen. For grasps this is any object of the scene."""
    needed = {question.about, *(question.answer if isinstance(question.answer, tuple) else ())}
    return bool(hidden if question.kind in OF_GRASPS else hidden & needed)


def _write_images(folder: Path, name: str, observation: Mapping[str, NDArray[Any]]) -> dict[str, dict[str, str]]:
    """Write the images of a scene, and return their files by camera."""
    found: dict[str, dict[str, str]] = {}
    for camera in CAMERAS:
        for part in ("rgb", "segmentation"):
            file = f"images/{name}_{camera}_{part}.png"
            Image.fromarray(np.squeeze(observation[f"{camera}_{part}"])).save(folder / file)
            found.setdefault(camera, {})[part] = file
    return found


def read_lines(file: Path, needed: Sequence[str]) -> list[dict[str, Any]]:
    """The lines of a JSON Lines file.

    Args:
        file: to be read.
        needed: entries that every line has.

    Raises:
        LearningError: it cannot be read, or a line lacks an entry.
    """
    try:
        found = [json.loads(line) for line in file.read_text().splitlines() if line.strip()]
        for index, line in enumerate(found):
            if lacking := [name for name in needed if name not in line]:
                raise ValueError(f"line {index + 1} has no {lacking[0]!r}")
    except (OSError, ValueError, TypeError) as problem:
        raise LearningError(f"{file} cannot be read: {problem}") from problem
    return found
