"""Chain of torso and arm as arrays for kernels, from a robot, an MJCF file or a URDF file.

Robots offer the data of `Robot`. irm knows no robot by name or type. This module does not import the simulator.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from irm.errors import ChainError
from irm.rotations import frame_along
from irm.self_contact import BASE as BASE
from irm.shapes import NO_SHAPES, Shapes

if TYPE_CHECKING:
    import mujoco

Floats = NDArray[np.float64]
PRISMATIC = 3
"""Added to the axis number (x 0, y 1, z 2) of a joint that slides along its axis."""
Integers = NDArray[np.int64]
FETCH_AXES = (2 + PRISMATIC, 2, 1, 0, 1, 0, 1, 0)
_FULL_TURN_ROUNDING = 1e-4
"""[rad] A joint range that misses a full turn by less is unlimited: model files have rounded numbers."""
_SAME_LIMIT = 1e-9
"""[rad] Limits that differ by less are equal up to rounding. Within it NO is proved with a margin."""
_ON_AXIS = 1e-4
"""[rad], [m] A TCP turns about the last joint's axis if its approach lies this close to it, for the same reason."""


class Joint(Protocol):
    """One joint of the chain torso → arm, as `assets.ChainLink`.

    `joint` is its name. `offset` (3,) [m] and `rotation` (3, 3) place its frame in its parent's frame at zero.
    `direction` (3,) is the unit vector of its axis in its own frame. `lower` and `upper` are its limits [m] or [rad].
    `prismatic`: whether it slides along its axis.
    """

    # fmt: off
    @property
    def joint(self) -> str: ...
    @property
    def offset(self) -> Sequence[float]: ...
    @property
    def rotation(self) -> NDArray[np.float64]: ...
    @property
    def direction(self) -> Sequence[float]: ...
    @property
    def lower(self) -> float: ...
    @property
    def upper(self) -> float: ...
    @property
    def prismatic(self) -> bool: ...
    # fmt: on


_NO_TURN = np.eye(3)
_NO_TURN.setflags(write=False)


class JointRow(NamedTuple):
    """One joint of a table of joints, with the fields of `Joint`. `direction` is (1, 0, 0), (0, 1, 0), (0, 0, 1), or
    any unit vector."""

    joint: str
    offset: Sequence[float]
    direction: Sequence[float]
    lower: float
    upper: float
    prismatic: bool = False
    rotation: NDArray[np.float64] = _NO_TURN


class JointTable(NamedTuple):
    """Joints of a chain and its TCP, the input of `frames_of`."""

    chain: Sequence[Joint]
    tcp_offset: Sequence[float]
    tcp_rotation: NDArray[np.float64]


class Robot(Hashable, Protocol):
    """A mobile manipulator. `assets.RobotSpec` explains the attributes."""

    # fmt: off
    @property
    def full_name(self) -> str: ...
    @property
    def chain(self) -> Sequence[Joint]: ...
    @property
    def tcp_offset(self) -> Sequence[float]: ...
    @property
    def tcp_rotation(self) -> NDArray[np.float64]: ...
    @property
    def home(self) -> Sequence[float]: ...
    @property
    def plans_torso(self) -> bool: ...
    @property
    def closed_form_ik(self) -> str: ...
    @property
    def map_folder(self) -> Path | None: ...
    @property
    def shapes(self) -> Shapes: ...
    @property
    def mjcf_path(self) -> Path: ...
    @property
    def base_body(self) -> str: ...
    @property
    def tcp_site(self) -> str: ...
    @property
    def finger_joints(self) -> tuple[str, ...]: ...
    @property
    def max_finger_position(self) -> float: ...
    # fmt: on


@dataclass(frozen=True)
class ArmChain:
    """A robot's torso and arm as arrays for kernels. Arrays are read-only.

    Attributes:
        robot: its name.
        offsets: (1 + n, 3) origin of each joint frame in its parent's frame [m], if all frames are parallel at zero.
            Otherwise (1 + n, 12): origin, then orientation in the parent's frame, row by row.
        axes: (1 + n,) 0, 1, 2 for hinges about x, y, z, and 3, 4, 5 for slides along them.
        lower, upper: (1 + n,) joint limits [m], [rad].
        tip: (3,) TCP in the last link's frame [m], or (12,) with its orientation, as in `offsets`.
        joints: (1 + n) names, "" for an arm without a lift.
        shapes: collision shapes of the whole robot. Empty if only the joints are known.
        home_torso: torso height of a map whose torso does not move [m].
        links: (7,) lengths for `irm.ik.closed_form`. Empty for arms without the structure of Fetch's arm.
    """

    robot: str
    offsets: Floats
    axes: Integers
    lower: Floats
    upper: Floats
    tip: Floats
    joints: tuple[str, ...] = ()
    shapes: Shapes = NO_SHAPES
    home_torso: float = 0.0
    links: Floats = field(default_factory=lambda: np.empty(0))

    @property
    def has_closed_form(self) -> bool:
        """Whether `irm.ik.closed_form` works for this arm."""
        return self.links.size > 0

    @property
    def size(self) -> int:
        """Number of joints, torso included."""
        return self.axes.size

    @property
    def shoulder(self) -> Floats:
        """(3,) origin of the first arm joint with the torso at 0, in the base frame [m]."""
        return np.asarray(self.offsets[0, :3] + self.offsets[1, :3])

    @property
    def reach(self) -> float:
        """Upper bound of the distance between the first arm joint and the TCP [m]: all link lengths, slides
        extended."""
        links = np.linalg.norm(self.offsets[2:, :3], axis=1).sum() + np.linalg.norm(self.tip[:3])
        slides = np.maximum(np.abs(self.lower[1:]), np.abs(self.upper[1:]))[self.axes[1:] >= PRISMATIC]
        return float(links + slides.sum())

    @staticmethod
    def of(robot: Robot | ArmChain) -> ArmChain:
        """The chain of a robot, or the chain itself.

        Raises:
            ChainError: it is neither, or the robot's joints are not those of an arm.
        """
        if isinstance(robot, ArmChain):
            return robot
        if not hasattr(robot, "chain"):
            raise ChainError(f"a robot is a RobotSpec such as assets.FETCH, or an ArmChain, not {robot!r}")
        return ArmChain.from_robot(robot)

    @staticmethod
    def from_robot(robot: Robot) -> ArmChain:
        """The chain of a robot.

        Raises:
            ChainError: its first joint is no vertical slide, or it names a closed form that does not fit it.
        """
        offsets, axes, tip = frames_of(robot)
        if axes[0] != 2 + PRISMATIC or not np.array_equal(robot.chain[0].rotation, np.eye(3)):
            raise ChainError(
                f"{robot.full_name}: the first joint of the chain must slide along z (lower = upper for a robot "
                f"without a lift), not {robot.chain[0]}"
            )
        lower = np.array([link.lower for link in robot.chain], dtype=float)
        upper = np.array([link.upper for link in robot.chain], dtype=float)
        if not robot.plans_torso:
            lower[0] = upper[0] = robot.home[0]
        chain = ArmChain(
            robot.full_name,
            offsets,
            axes,
            lower,
            upper,
            tip,
            tuple(link.joint for link in robot.chain),
            robot.shapes,
            float(robot.home[0]),
        )
        if robot.closed_form_ik not in ("", "fetch"):
            raise ChainError(f"{chain.robot}: no closed form {robot.closed_form_ik!r}; known: 'fetch', or '' for none")
        links = _fetch_links(chain) if robot.closed_form_ik else np.empty(0)
        if robot.closed_form_ik and not links.size:
            raise ChainError(
                f"{chain.robot}: the closed form 'fetch' needs a vertical slide, then axes z y x y x y x with every "
                "offset after the shoulder along x and none to the side, symmetric limits of elbow and wrist flex, and "
                "free rolls"
            )
        return _with_links(chain, links)

    @staticmethod
    def from_joints(
        joints: Sequence[JointRow], tcp_offset: Sequence[float], tcp_rotation: Floats = _NO_TURN, name: str = "arm"
    ) -> ArmChain:
        """The chain of a table of joints, one row per joint from the base on. It needs no file and no model.

        A lift, a slide along z, comes first. The chain has no shapes, so every configuration is taken as free of
        self-collision.

        Args:
            joints: of the arm.
            tcp_offset: (3,) origin of the TCP in the last joint's frame [m]. Its x axis is the approach.
            tcp_rotation: (3, 3) its orientation there.
            name: of the arm.

        Raises:
            ChainError: these are not the joints of an arm.
        """
        rows = list(joints)
        if not rows or not rows[0].prismatic:
            rows.insert(0, JointRow("", (0.0, 0.0, 0.0), (0.0, 0.0, 1.0), 0.0, 0.0, True))
        hinges = [row for row in rows[1:] if not row.prismatic]
        if len(hinges) not in (6, 7) or len(hinges) != len(rows) - 1:
            raise ChainError(f"{name}: an arm has 6 or 7 hinges, after one vertical slide if it stands on a lift")
        if not all(np.isfinite((row.lower, row.upper)).all() and row.lower <= row.upper for row in rows):
            raise ChainError(f"{name}: every joint needs finite limits, the lower one first")
        table = JointTable(tuple(rows), tcp_offset, np.asarray(tcp_rotation, dtype=float))
        offsets, axes, tip = frames_of(table)
        if axes[0] != 2 + PRISMATIC or not np.array_equal(rows[0].rotation, np.eye(3)):
            raise ChainError(f"{name}: the lift must slide along the base frame's z axis")
        limits = np.array([(row.lower, row.upper) for row in rows], dtype=float).T.copy()
        chain = ArmChain(name, offsets, axes, limits[0].copy(), limits[1].copy(), tip, tuple(row.joint for row in rows))
        return _with_links(chain, _fetch_links(chain))

    @staticmethod
    def from_mjcf(model: mujoco.MjModel | str | Path, base: str, tip: str, approach: str = "x") -> ArmChain:
        """The chain of any serial arm of 6 or 7 hinges, with or without a vertical lift.

        Frames, axes, their signs, the tool's rotation, limits and continuous joints are those of the model.
        Configurations have the model's joint values. Without a lift their first value is 0. Joints that are not between
        base and tip stay at their initial positions.

        Args:
            model: a compiled model, or the path of its file. A URDF file is read as in `from_urdf`.
            base: name of the body whose frame is the base frame, with z up. "world" is the fixed body.
            tip: name of the site or body whose frame is the TCP frame.
            approach: the axis of that frame along which the gripper approaches: "x", "-x", "y", "-y", "z" or "-z". The
                x axis of irm's TCP frame is the approach, so the frame is turned for any other axis.

        Raises:
            ChainError: no such body, or the joints between base and tip are not of this kind. The message lists them.

        Example:
            chain = ArmChain.from_mjcf("panda.xml", base="link0", tip="grip_site", approach="z")
            rm = ReachabilityMap.build(chain)
        """
        from irm.model_reading import load_urdf, read_arm  # needs the simulator, which the package does not

        if isinstance(model, str | Path) and Path(model).suffix == ".urdf":
            model = load_urdf(Path(model))
        chain = ArmChain(**read_arm(model, base, tip, approach))
        return _with_links(chain, _fetch_links(chain))

    @staticmethod
    def from_urdf(path: str | Path, base: str, tip: str, approach: str = "x") -> ArmChain:
        """The chain of such an arm in a URDF file. Arguments, names of links and errors as in `from_mjcf`.

        Collision meshes are shapes too. Links without collision shapes use their visual shapes. A missing mesh file
        yields no shape, and a warning is logged.
        """
        from irm.model_reading import load_urdf, read_arm  # see `from_mjcf`

        chain = ArmChain(**read_arm(load_urdf(Path(path)), base, tip, approach))
        return _with_links(chain, _fetch_links(chain))


def has_free_roll(chain: ArmChain) -> bool:
    """Whether the last joint turns the gripper about its approach axis without limit."""
    axis = np.eye(3)[chain.axes[-1] % PRISMATIC]
    approach = chain.tip[3:].reshape(3, 3)[:, 0] if chain.tip.size > 3 else np.array([1.0, 0.0, 0.0])
    away = max(np.linalg.norm(np.cross(axis, approach)), np.linalg.norm(np.cross(axis, chain.tip[:3])))
    turn = chain.upper[-1] - chain.lower[-1]
    return bool(chain.axes[-1] < PRISMATIC and away < _ON_AXIS and turn >= 2 * np.pi - _FULL_TURN_ROUNDING)


def _with_links(chain: ArmChain, links: Floats) -> ArmChain:
    """Make the chain's arrays read-only and add the lengths of its closed form."""
    for array in (chain.offsets, chain.axes, chain.lower, chain.upper, chain.tip, links):
        array.setflags(write=False)
    return replace(chain, links=links)


def _fetch_links(chain: ArmChain) -> Floats:
    """The seven lengths of `irm.ik.closed_form`. Empty if the arm does not have the structure of Fetch's arm."""
    if tuple(chain.axes.tolist()) != FETCH_AXES or chain.tip.size > 3:
        return np.empty(0)
    offset, lower, upper = chain.offsets, chain.lower, chain.upper
    along_x = np.vstack([offset[3:], [chain.tip]])
    fits = (
        not along_x[:, 1:].any()
        and not offset[:3, 1].any()
        and offset[2, 0] > 0.0
        and bool(np.allclose(lower[[4, 6]], -upper[[4, 6]], rtol=0.0, atol=_SAME_LIMIT))
        and bool(np.all(lower[[3, 5, 7]] <= -np.pi))
        and bool(np.all(upper[[3, 5, 7]] >= np.pi))
    )
    if not fits:
        return np.empty(0)
    pan, shoulder = offset[0, [0, 2]] + offset[1, [0, 2]], offset[2, [0, 2]]
    x = along_x[:, 0]
    return np.array([*pan, *shoulder, x[0] + x[1], x[2] + x[3], x[4] + x[5]])


class ChainArrays(NamedTuple):
    """Arrays of `ArmChain`, for kernels."""

    offsets: Floats
    axes: NDArray[np.int64]
    tip: Floats
    lower: Floats
    upper: Floats
    links: Floats


class ChainKey:
    """Key for `lru_cache`: chains with the same arrays are equal."""

    def __init__(self, chain: ArmChain) -> None:
        self.chain = chain
        arrays = (chain.offsets, chain.axes, chain.lower, chain.upper, chain.tip, chain.links)
        self._content = tuple(array.tobytes() for array in arrays)

    def __hash__(self) -> int:
        return hash(self._content)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, ChainKey) and self._content == other._content


def chain_arrays(chain: ArmChain, torso_range: tuple[float, float] | None = None) -> ChainArrays:
    """Read-only copies of a chain's arrays. `torso_range` [m] replaces the limits of its torso."""
    arrays = ChainArrays(*(getattr(chain, name).copy() for name in ChainArrays._fields))
    if torso_range is not None:
        arrays.lower[0], arrays.upper[0] = torso_range
    for array in arrays:  # kernels are compiled once, for one type of arrays
        array.setflags(write=False)
    return arrays


def pose_of(place: Floats) -> Floats:
    """The pose (4, 4) of a row of `ArmChain`: an origin (3,), or with the nine entries of an orientation (12,)."""
    T = np.eye(4)
    T[:3, 3] = place[:3]
    if place.size > 3:
        T[:3, :3] = place[3:].reshape(3, 3)
    return T


def frames_of(robot: Robot | JointTable) -> tuple[Floats, NDArray[np.int64], Floats]:
    """Offsets (1 + n, 3 or 12), axes (1 + n,) and tip (3,) or (12,) of a robot's chain, as in `ArmChain`.

    A joint about an axis of its own frame keeps that frame. Any other joint gets a frame with z along its axis.
    """

    def place(offset: Sequence[float], R: Floats) -> Floats:
        """(12,) origin and orientation, row by row, of a frame in its parent, which `before` turned."""
        return np.concatenate([before.T @ np.asarray(offset, dtype=float), (before.T @ R).ravel()])

    places, axes, before = [], [], np.eye(3)
    for link in robot.chain:
        direction = np.array(link.direction)
        numbers = [k for k, axis in enumerate(np.eye(3)) if np.array_equal(direction, axis)]
        number, own = (numbers[0], np.eye(3)) if numbers else (2, frame_along(direction / np.linalg.norm(direction)))
        places.append(place(link.offset, link.rotation @ own))
        axes.append(number + (PRISMATIC if link.prismatic else 0))
        before = own
    places.append(place(robot.tcp_offset, robot.tcp_rotation))
    rows = np.array(places)
    if np.array_equal(rows[:, 3:], np.tile(np.eye(3).ravel(), (len(rows), 1))):
        rows = rows[:, :3]
    return rows[:-1].copy(), np.array(axes, dtype=np.int64), rows[-1].copy()
