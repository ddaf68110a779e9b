"""Arms from tables of joints, as their makers' files have them: rounded angles, limits at right angles, wrists that are
not spherical."""

from __future__ import annotations

import numpy as np

from irm.chain import ArmChain, JointRow
from irm.rotations import rotation

X, Y, Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)


def minus(axis):
    return tuple(-value for value in axis)


def puma560(digits):
    """Its angles of π/2 rounded to some digits after the point, as in its URDF file, which has nine."""
    right, half_turn = round(np.pi / 2, digits), round(np.pi, digits - 1)
    rows = [
        ((0.0, 0.0, 0.6718), (right, 0.0, 0.0), Y, half_turn),
        ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), Z, right),
        ((0.4318, -0.0203, 0.1501), (0.0, 0.0, -right), Z, right),
        ((0.0, 0.0, 0.0), (right, 0.0, right), Z, right),
        ((0.0, 0.0, 0.4331), (right, 0.0, 0.0), Z, right),
        ((0.0, 0.0, 0.0), (-right, 0.0, 0.0), Z, right),
    ]
    joints = [
        JointRow(f"joint{k}", offset, axis, -limit, limit, rotation=rotation(yaw, pitch, roll))
        for k, (offset, (roll, pitch, yaw), axis, limit) in enumerate(rows)
    ]
    return ArmChain.from_joints(joints, (0.0, 0.0558, 0.0), name="puma560")


def widowx_ai(digits=6):
    """Three parallel axes; with fewer digits the second of them is tilted, as a rounded π/2 in its file would do."""
    tilt = rotation(0.0, 0.0, round(np.pi / 2, digits) - np.pi / 2)
    return ArmChain.from_joints(
        [
            JointRow("joint_0", (0.0, 0.0, 0.05725), Z, -3.05433, 3.05433),
            JointRow("joint_1", (0.02, 0.0, 0.04625), Y, 0.0, 3.14159),
            JointRow("joint_2", (-0.264, 0.0, 0.0), minus(Y), 0.0, 2.35619, rotation=tilt),
            JointRow("joint_3", (0.245, 0.0, 0.06), minus(Y), -1.5708, 1.5708),
            JointRow("joint_4", (0.06775, 0.0, 0.0455), minus(Z), -1.5708, 1.5708),
            JointRow("joint_5", (0.02895, 0.0, -0.0455), X, -3.14159, 3.14159),
        ],
        (0.156, 0.0, 0.0),
        name="widowx_ai",
    )


def viperx_300s():
    return ArmChain.from_joints(
        [
            JointRow("waist", (0.0, 0.0, 0.079), Z, -3.14158, 3.14158),
            JointRow("shoulder", (0.0, 0.0, 0.04805), Y, -1.85005, 1.25664),
            JointRow("elbow", (0.05955, 0.0, 0.3), Y, -1.76278, 1.6057),
            JointRow("forearm_roll", (0.2, 0.0, 0.0), X, -3.14158, 3.14158),
            JointRow("wrist_angle", (0.1, 0.0, 0.0), Y, -1.8675, 2.23402),
            JointRow("wrist_rotate", (0.069744, 0.0, 0.0), X, -3.14158, 3.14158),
        ],
        (0.15, 0.0, 0.0),
        name="viperx_300s",
    )


def openarm():
    rows = [
        ((0.0, 0.0625, 0.0), Y, -3.4907, 1.3963),
        ((0.0, 0.06, 0.0), minus(X), -3.3161, 0.17453),
        ((0.0, 0.0, -0.06625), minus(Z), -1.5708, 1.5708),
        ((0.0, 0.0, -0.15375), minus(Y), 0.0, 2.4435),
        ((0.0, 0.0, -0.0955), minus(Z), -1.5708, 1.5708),
        ((0.0, 0.0, -0.1205), minus(Y), -0.7854, 0.7854),
        ((0.0, 0.0, 0.0), X, -1.5708, 1.5708),
    ]
    joints = [JointRow(f"joint{k + 1}", *row) for k, row in enumerate(rows)]
    return ArmChain.from_joints(joints, (0.0, 0.0, 0.0), rotation(0.0, np.pi / 2, 0.0), name="openarm")


def baxter():
    """Seven joints; the fifth axis passes the last two, which meet, at 10 mm: no closed form."""
    rows = [
        ((0.0557, 0.0, 0.011), Z, -1.7017, 1.7017),
        ((0.069, 0.0, 0.27035), Y, -2.147, 1.047),
        ((0.102, 0.0, 0.0), X, -3.0542, 3.0542),
        ((0.26242, 0.0, -0.069), Y, -0.05, 2.618),
        ((0.10359, 0.0, 0.0), X, -3.059, 3.059),
        ((0.2707, 0.0, -0.01), Y, -1.5708, 2.094),
        ((0.115975, 0.0, 0.0), X, -3.059, 3.059),
    ]
    return ArmChain.from_joints([JointRow(f"joint{k}", *row) for k, row in enumerate(rows)], (0.2, 0.0, 0.0))


def tiago():
    """Six joints on a lift, with two axes at the wrist: no closed form."""
    rows = [
        ((0.0, 0.0, 0.3), Z, 0.0, 0.35, True),
        ((0.0, 0.0, 0.2), Z, -1.1781, 1.5708),
        ((0.125, 0.0, 0.0), Y, -1.1781, 1.5708),
        ((0.0895, 0.0, 0.0), X, -0.7854, 3.927),
        ((0.2226, 0.0, 0.02), Y, -0.3927, 2.3562),
        ((0.1626, 0.0, -0.02), X, -2.0944, 2.0944),
        ((0.15, 0.0, 0.0), Y, -1.4137, 1.4137),
    ]
    return ArmChain.from_joints([JointRow(f"joint{k}", *row) for k, row in enumerate(rows)], (0.2, 0.0, 0.0))


def hard_configurations(chain, kind, count, rng):
    """(count, 1 + n) within the limits, six of ten joints at "limits", "inside" (1 µrad to 1 mrad from there), at
    "right angles", "jittered" (1 mrad beside these), or "uniform" all."""
    middle = (chain.lower + chain.upper) / 2
    low, high = np.maximum(chain.lower, middle - np.pi), np.minimum(chain.upper, middle + np.pi)
    q = rng.uniform(low, high, (count, chain.size))
    is_hard, is_low = rng.random(q.shape) < 0.6, rng.random(q.shape) < 0.5
    hard = np.where(is_low, chain.lower, chain.upper)
    if kind == "inside":
        hard = hard + np.where(is_low, 1.0, -1.0) * 10 ** rng.uniform(-6, -3, q.shape)
    elif kind in ("right angles", "jittered"):
        right = np.round(q * 2 / np.pi) * np.pi / 2
        hard = np.where((right >= chain.lower) & (right <= chain.upper), right, q)
    q = np.where(is_hard & (kind != "uniform"), hard, q)
    q += rng.uniform(-1e-3, 1e-3, q.shape) if kind == "jittered" else 0.0
    return np.clip(q, chain.lower, chain.upper)
