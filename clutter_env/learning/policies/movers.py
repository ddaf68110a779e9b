"""The learned movers by name: how each is fitted to demonstrations, written and read."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

from torch import nn

from assets import RobotSpec
from clutter_env.learning.chunking.chunks import ChunkNetwork, fit_chunks
from clutter_env.learning.chunking.examples import chunk_examples
from clutter_env.learning.chunking.flow import FlowNetwork, fit_flow
from clutter_env.learning.chunking.mover import ChunkMover
from clutter_env.learning.contacts.protocols import Mover
from clutter_env.learning.keyframes.boards.cutting import is_driven
from clutter_env.learning.keyframes.boards.shown_postures import shown_postures
from clutter_env.learning.keyframes.examples import examples_of
from clutter_env.learning.keyframes.fit import FitConfig, fit_keyframes
from clutter_env.learning.keyframes.ground import closed_ground
from clutter_env.learning.keyframes.motions import Motion
from clutter_env.learning.keyframes.mover import KeyframeMover
from clutter_env.learning.keyframes.network import KeyframeNetwork, load_arrays
from clutter_env.learning.regression.descent import DescentConfig, Report

__all__ = ["FittedMover", "fit_mover", "load_mover"]


class FittedMover(NamedTuple):
    """A mover, and the network behind it."""

    mover: Mover
    network: nn.Module


class _Settings(NamedTuple):
    """Gradient steps, random seed, and what the loss is reported to."""

    steps: int
    seed: int
    report: Report


def _keyframes(robot: RobotSpec, motions: Sequence[Motion], settings: _Settings) -> FittedMover:
    config = FitConfig(steps=settings.steps, seed=settings.seed)
    network = fit_keyframes(robot, examples_of(robot, motions), config, settings.report)
    if network.is_under_board:
        network.offer_postures(shown_postures(robot, [motion for motion in motions if is_driven(motion)]))
    network.keep_out_of(closed_ground(motions))
    return FittedMover(KeyframeMover(network), network)


def _chunks(robot: RobotSpec, motions: Sequence[Motion], settings: _Settings) -> FittedMover:
    config = DescentConfig(steps=settings.steps, seed=settings.seed)
    network = fit_chunks(chunk_examples(robot, motions), config, settings.report)
    return FittedMover(ChunkMover(network), network)


def _flow(robot: RobotSpec, motions: Sequence[Motion], settings: _Settings) -> FittedMover:
    config = DescentConfig(steps=settings.steps, seed=settings.seed)
    network = fit_flow(chunk_examples(robot, motions), config, settings.report)
    return FittedMover(ChunkMover(network), network)


_FIT: Mapping[str, Callable[[RobotSpec, Sequence[Motion], _Settings], FittedMover]] = MappingProxyType(
    {"keyframes": _keyframes, "chunks": _chunks, "flow": _flow}
)


def fit_mover(
    algorithm: str,
    robot: RobotSpec,
    motions: Sequence[Motion],
    steps: int,
    seed: int = 0,
    report: Report = lambda *_: None,
) -> FittedMover:
    """A mover fitted to the motions of demonstrations.

    Args:
        algorithm: "keyframes", "chunks" or "flow".
        robot: that was demonstrated.
        motions: to imitate.
        steps: gradient steps.
        seed: random seed.
        report: called with the step and the loss every 500 steps.

    Raises:
        DatasetError: there are no motions.
    """
    return _FIT[algorithm](robot, motions, _Settings(steps, seed, report))


def load_mover(algorithm: str, path: Path) -> Mover:
    """The mover whose network was written to a file with `save_arrays`.

    Raises:
        DatasetError: there is no such file, or it holds no weights.
    """
    if algorithm == "keyframes":
        return KeyframeMover(KeyframeNetwork.load(path))
    arrays = load_arrays(path)
    width, inputs = arrays["layers.0.weight"].shape
    if algorithm == "chunks":
        chunks = ChunkNetwork(inputs, width)
        chunks.load_state_dict(arrays)
        return ChunkMover(chunks)
    flow = FlowNetwork(inputs - FlowNetwork.OWN_INPUTS, width)
    flow.load_state_dict(arrays)
    return ChunkMover(flow)
