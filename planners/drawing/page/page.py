"""A page for a browser: a recording of an episode, or of a plan without physics, as one HTML file."""

from __future__ import annotations

import html
from collections.abc import Iterator, Mapping
from importlib.resources import files
from pathlib import Path

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from planners.drawing.page.content import page_text
from planners.expert.report import Frame, Recording, Solve
from planners.motion.arm import tcp_pose
from planners.motion.mujoco_check import OBJECT, OPENING, ModelPositions, scene_model
from planners.motion.trajectory import CONTROL_STEP
from planners.scene import Body, Pull, RobotState, Scene
from planners.scene.moving import carried_by, moved, without_pull
from planners.tamp.solution import Solution

_SCRIPTS = (
    "matrix",
    "shapes",
    "renderer",
    "data",
    "marks",
    "picking",
    "scene",
    "camera",
    "timeline",
    "panel",
    "why",
    "hand",
    "page",
)
"""Scripts in their order on the page: each uses those before it."""
_SUPPORT, _OTHER = (0.80, 0.68, 0.53, 1.0), (0.86, 0.87, 0.88, 1.0)
"""Colours of supports and of other static obstacles."""


def write_page(path: Path, recording: Recording, rows: Mapping[str, str], result: str = "", title: str = "") -> None:
    """Write the page of a recording, with the names and values of its report. `result` as for `page_text`."""
    title = title or episode_title(recording)
    path.write_text(page_html(title, page_text(recording, title, rows, result)), encoding="utf-8")


def episode_title(recording: Recording) -> str:
    """Title, such as "object_03 out of 15 objects". For a goal with places, "8 objects"."""
    return f"{recording.target} out of {len(recording.objects)} objects".removeprefix(" out of ")


def page_html(title: str, content: str, address: str = "", moves: str = "") -> str:
    """Page of a JSON text, as from `ArrayBlock.text`.

    `address` is the address of the events of a running episode, on the page's own server, "" for none. `moves` is that
    to which a person's moves are sent, "" where the page only shows.
    """
    folder = files(__package__) / "static"
    scripts = "\n".join((folder / f"{name}.js").read_text(encoding="utf-8") for name in _SCRIPTS)
    parts = {
        "TITLE": html.escape(title),
        "ADDRESS": html.escape(address),
        "MOVES": html.escape(moves),
        "CONNECT": "'self'" if address else "'none'",
        "STYLE": (folder / "page.css").read_text(encoding="utf-8"),
        "SCRIPT": scripts,
        "CONTENT": content,
    }
    text = (folder / "page.html").read_text(encoding="utf-8")
    for name, part in parts.items():
        text = text.replace(f"@{name}@", part)
    return text


def write_plan_page(plan: Solution, path: Path) -> None:
    """Write the page of a plan, as `Solution.to_html` does."""
    lines = (line.partition(": ") for line in plan.summary().splitlines())
    rows = {name.strip(): value for name, _, value in lines if value}
    what = f"{plan.target} after {len(plan.clearances)} clearances" if plan.target else f"{plan.picks} picks"
    write_page(path, plan_recording(plan), rows, "plan", f"Plan: {what}")


def plan_recording(plan: Solution) -> Recording:
    """Recording of a plan's motions, one action after the other. A held object moves with the gripper, all others rest.

    A held handle moves its drawer or door, and the contents.
    """
    if not plan.actions:
        raise ValueError("a plan without actions has nothing to show")
    first = without_pull(plan.actions[0].scene)
    model = scene_model(first, can_open=True)
    for geom in range(model.ngeom):  # the planner's scene has no colours for static obstacles
        name, body = model.geom(geom).name, model.body(model.geom_bodyid[geom]).name
        if body == "world" or body.startswith(OPENING):
            model.geom_rgba[geom] = _SUPPORT if name.rpartition("/")[2] in first.supports[:1] else _OTHER
    names = tuple(OBJECT + body.name for body in first.objects)
    solve = Solve(0.0, plan, first, plan.grasps)
    return Recording(model, plan.target, names, tuple(_frames(plan, model)), (solve,))


def _frames(plan: Solution, model: mujoco.MjModel) -> Iterator[Frame]:
    """Frames, one for each control step. The scene of an action gives object poses and openings."""
    start = 0.0
    for index, action in enumerate(plan.actions):
        scene, trajectory = without_pull(action.scene), action.trajectory
        positions = ModelPositions(model, scene, np.array(model.qpos0))
        for one in scene.openings:
            positions.open(one.name, one.position)
        aside = [(one.held, scene.using(one.arm)) for one in scene.aside]
        for time in np.append(np.arange(0.0, trajectory.duration, CONTROL_STEP), trajectory.duration):
            sample = trajectory.sample(float(time))
            positions.move(np.array([*sample.base, *sample.q, sample.finger_position]))
            state = RobotState(sample.base, sample.q, sample.finger_position)
            in_hand = [(other, arm.robot, RobotState(state.base, arm.state.q, 0.0)) for other, arm in aside]
            if sample.phase.held and sample.phase.touched is not None:
                in_hand.append((sample.phase.touched, scene.robot, state))
            for held, robot, holding in in_hand:
                body = scene.body(held.name).at_pose(tcp_pose(robot, holding) @ held.T_tcp_object)
                positions.put(body.name, body.position, body.quaternion)
            if action.scene.pull is not None and sample.phase.name == "pull" and sample.phase.touched is not None:
                handle = action.scene.body(action.scene.pull.handle)
                there = handle.at_pose(tcp_pose(scene.robot, state) @ sample.phase.touched.T_tcp_object)
                _pull(positions, action.scene, action.scene.pull, there)
            phase = f"{f'{action.name} {action.target}'.rstrip()}: {sample.phase.name}"
            yield Frame(start + float(time), positions.qpos.astype(np.float32), 0, index, phase)
        start += trajectory.duration


def _pull(positions: ModelPositions, scene: Scene, pull: Pull, handle: Body) -> None:
    """Move the drawer or door of a handle to the handle's position, with the contents."""
    opening, before = scene.opening(pull.opening), scene.body(pull.handle)
    if opening.kind == "slide":
        by = float((handle.position - before.position) @ opening.axis)
    else:
        by = float(Rotation.from_matrix(handle.rotation @ before.rotation.T).as_rotvec() @ opening.axis)
    positions.open(opening.name, opening.position + by)
    there = moved(scene, opening.name, opening.position + by)
    for name in carried_by(scene, opening):
        if name != pull.handle:
            body = there.body(name)
            positions.put(name, body.position, body.quaternion)
