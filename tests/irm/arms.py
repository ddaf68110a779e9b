"""Arms as small MJCF files, with the kinematics of well-known robots."""

from __future__ import annotations

from pathlib import Path

import mujoco

from irm.chain import ArmChain

FOLDER = Path(__file__).resolve().parents[1] / "data" / "arms"

APPROACH = {"panda": "z", "ur5e": "z", "gen3": "z", "pr2_arm": "x"}
"""Axis of the site `tcp` along which each gripper approaches."""


def arm_model(name: str) -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_path(str(FOLDER / f"{name}.xml"))


def arm_chain(name: str) -> ArmChain:
    return ArmChain.from_mjcf(FOLDER / f"{name}.xml", "base", "tcp", APPROACH[name])
