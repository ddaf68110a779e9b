"""The search expert as a policy, which `clutter-env evaluate` and `clutter-env audit` play by its name.

clutter-env evaluate --suite hidden-shelf-10-v2 --policy examples.search_expert:Searches --scenes 20
clutter-env audit hidden-shelf-10-v2 --expert examples.search_expert:Searches --scenes 12 --demonstrations 4
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from planners import SearchExpert


class Searches:
    """Acts as the expert does: by camera data alone, and by a model of the robot and the furniture.

    It is of the privileged track, because it asks the environment for that model.
    """

    is_privileged = True

    def reset(self, info: Mapping[str, Any], env: gym.Env[Any, Any]) -> None:  # noqa: ARG002  of the protocol
        """Begin an episode."""
        self._expert, self._has_begun = SearchExpert(env), False

    @property
    def done(self) -> bool:
        """Whether the target has been lifted, or the expert has given up."""
        return self._has_begun and self._expert.done

    def act(self, observation: Mapping[str, NDArray[Any]]) -> NDArray[np.float64]:
        """The expert's action; it receives the first observation at the first call."""
        if not self._has_begun:
            self._expert.reset(observation)
            self._has_begun = True
        return self._expert.act(observation)
