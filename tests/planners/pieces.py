"""Objects of several convex pieces for tests."""

from __future__ import annotations

import numpy as np

from planners.scene import Body, Solid


def mug(name: str = "mug", position: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Body:
    """A floor, eight wall pieces and a handle of three boxes."""
    pieces = [Solid("floor", np.array((0.0, 0.0, 0.003)), np.array((0.038, 0.038, 0.003)), "cylinder")]
    for k in range(8):
        turn = k * np.pi / 4
        c, s = np.cos(turn), np.sin(turn)
        R = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        at = R @ (0.036, 0.0, 0.05)
        pieces.append(Solid(f"wall {k}", at, np.array((0.002, 0.0155, 0.05)), "box", R))
    for height in (0.03, 0.08):
        pieces.append(Solid(f"arm {height}", np.array((0.053, 0.0, height)), np.array((0.015, 0.005, 0.005))))
    pieces.append(Solid("grip", np.array((0.068, 0.0, 0.055)), np.array((0.005, 0.005, 0.03))))
    return Body.of_pieces(name, pieces, position)


def bottle(name: str = "bottle", position: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Body:
    """Two cylinders, one on the other."""
    low = Solid("body", np.array((0.0, 0.0, 0.07)), np.array((0.035, 0.035, 0.07)), "cylinder")
    neck = Solid("neck", np.array((0.0, 0.0, 0.17)), np.array((0.014, 0.014, 0.03)), "cylinder")
    return Body.of_pieces(name, [low, neck], position)


def bottle_with_shoulder(position: tuple[float, float, float]) -> Body:
    """A cylinder, a cone cut off above it, and a neck with a cap."""
    ends = [(0.033, 0.135), (0.014, 0.175)]
    cone = [(r * np.cos(a), r * np.sin(a), z) for r, z in ends for a in np.arange(16) * np.pi / 8]
    uprights = [
        Solid(name, np.array((0.0, 0.0, (low + high) / 2)), np.array((r, r, (high - low) / 2)), "cylinder")
        for name, r, low, high in (
            ("body", 0.033, 0.0, 0.135),
            ("neck", 0.013, 0.17, 0.195),
            ("cap", 0.015, 0.195, 0.212),
        )
    ]
    return Body.of_pieces("bottle", [*uprights, Solid.hull("shoulder", cone)], position)


def bowl(name: str = "bowl", position: tuple[float, float, float] = (0.0, 0.0, 0.0), slope: float = 0.0) -> Body:
    """A floor and a ring of hulls, too wide for a gripper; `slope` [m] is how much wider it is at its rim."""
    pieces = [Solid("floor", np.array((0.0, 0.0, 0.004)), np.array((0.06, 0.06, 0.004)), "cylinder")]
    for k in range(12):
        turns = np.array((k, k + 1)) * np.pi / 6
        rings = [(0.07 + out - thick, z) for out, z in ((0.0, 0.004), (slope, 0.07)) for thick in (0.0, 0.005)]
        corners = [(r * np.cos(a), r * np.sin(a), z) for r, z in rings for a in turns]
        pieces.append(Solid.hull(f"wall {k}", corners))
    return Body.of_pieces(name, pieces, position)


def cut_in_two(body: Body) -> Body:
    """A box as two boxes, beside each other along its x axis."""
    half = body.half_extents * (0.5, 1.0, 1.0)
    pieces = [Solid(side, np.array((sign * half[0], 0.0, 0.0)), half) for side, sign in (("left", -1), ("right", 1))]
    return Body.of_pieces(body.name, pieces, body.position, body.quaternion)
