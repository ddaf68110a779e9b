"""A network of some 100,000 parameters that clones demonstrations: what it wins takes no large model.

It is also trained with observations that are zeroed, or show the robot alone.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import closing
from itertools import pairwise
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from clutter_env.evaluation.blind import Demonstrations

HIDDEN = (256, 128)
"""Units of its two layers: with 15 objects and their observation, 0.1 million parameters."""
STEPS, BATCH, RATE = 2000, 256, 1e-3
"""Of the training."""
LONGER = 1.5
"""Time that it has, in those of the longest demonstration."""
_SMALL = 1e-3
"""Standard deviation below which a number of the observation is taken to be constant."""


class SmallNetwork:
    """Acts by a network that was trained on every step of the demonstrations.

    Attributes:
        env_keywords: of the demonstrations' environment.
        done: after `LONGER` times the longest demonstration.
        parameters: how many it has.
    """

    def __init__(self, known: Demonstrations, entries: Sequence[str], seed: int = 0) -> None:
        self.env_keywords = known.env_keywords
        self._entries, self._most, self._steps = tuple(entries), round(LONGER * known.longest), 0
        seen, wanted = self._pairs(known)
        self._mean, self._scale = seen.mean(axis=0), 1 / np.maximum(seen.std(axis=0), _SMALL)
        self._network = _trained((seen - self._mean) * self._scale, wanted, seed)
        self.parameters = sum(part.numel() for part in self._network.parameters())

    @property
    def done(self) -> bool:
        """Whether its time is up."""
        return self._steps >= self._most

    def reset(self, info: Mapping[str, Any]) -> None:  # noqa: ARG002  part of the protocol
        """Start an episode."""
        self._steps = 0

    def act(self, observation: Mapping[str, NDArray[Any]]) -> NDArray[np.float32]:
        """The action that the network gives."""
        self._steps += 1
        seen = torch.as_tensor((self._vector(observation) - self._mean) * self._scale)
        with torch.no_grad():
            return self._network(seen).clamp(-1.0, 1.0).numpy()

    def _vector(self, observation: Mapping[str, NDArray[Any]]) -> NDArray[np.float32]:
        # Of no entries at all, one number that is always the same.
        return np.concatenate([np.zeros(1), *(np.ravel(observation[name]) for name in self._entries)]).astype(
            np.float32
        )

    def _pairs(self, known: Demonstrations) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """What is seen (steps, m) and done (steps, n) in all demonstrations, played again."""
        seen = []
        with closing(known.scenes[0].make(**known.env_keywords)) as env:
            for scene, actions in zip(known.scenes, known.actions, strict=True):
                observation, _ = scene.reset(env)
                for action in actions:
                    seen.append(self._vector(observation))
                    observation, *_ = env.step(action)
        return np.array(seen), np.concatenate(known.actions)


def _trained(seen: NDArray[np.float32], wanted: NDArray[np.float32], seed: int) -> torch.nn.Sequential:
    """The network that was trained to give these actions for what is seen, by the mean absolute error."""
    torch.manual_seed(seed)
    threads = torch.get_num_threads()
    torch.set_num_threads(1)  # more only wait for one another: the network is small
    sizes = (seen.shape[1], *HIDDEN)
    layers: list[torch.nn.Module] = []
    for size, units in pairwise(sizes):
        layers += [torch.nn.Linear(size, units), torch.nn.ReLU()]
    network = torch.nn.Sequential(*layers, torch.nn.Linear(sizes[-1], wanted.shape[1]))
    inputs, outputs = torch.as_tensor(seen), torch.as_tensor(wanted)
    optimiser, generator = torch.optim.Adam(network.parameters(), RATE), torch.Generator().manual_seed(seed)
    for _ in range(STEPS):
        batch = torch.randint(len(inputs), (BATCH,), generator=generator)
        loss = (network(inputs[batch]) - outputs[batch]).abs().mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
    torch.set_num_threads(threads)
    return network
