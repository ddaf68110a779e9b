"""A server for vla-eval with a policy of this package; see `clutter_env.bridges.for_vla_eval`."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import closing
from typing import Any

import numpy as np
from vla_eval.model_servers.predict import PredictModelServer
from vla_eval.specs import RAW, DimSpec

from clutter_env.bridges.for_vla_eval import action_spec, made
from clutter_env.errors import LearningError
from clutter_env.policies.protocol import PublicInfo, check_public
from clutter_env.policies.registry import load_policy
from clutter_env.suites import suite as named_suite


class PackagePolicy(PredictModelServer):
    """Serves a policy of this package that acts on observations, to a `SuiteBenchmark` with `exact: true`.

    Args:
        policy: a name for `clutter-env evaluate`.
        suite: which it will play.
        chosen: more arguments of vla-eval's own class.

    Raises:
        LearningError: the policy is of the privileged track, or acts by skills.
        PolicyError: there is no such policy, or it cannot play the suite.
    """

    def __init__(self, policy: str, suite: str, **chosen: Any) -> None:
        super().__init__(**chosen)
        self._policy: Any = load_policy(policy, 0)
        if getattr(self._policy, "is_privileged", False) or getattr(self._policy, "acts_by_skills", False):
            raise LearningError(f"{policy} does not act on observations alone, step by step")
        with closing(made(named_suite(suite), True, getattr(self._policy, "env_keywords", {}))) as env:
            env.reset(seed=0)
            self._public = PublicInfo.of(env)

    def predict(self, obs: Mapping[str, Any], ctx: Any) -> dict[str, Any]:  # noqa: ARG002  the harness's interface
        """The action of the policy for an observation; `done` once it has finished or given up."""
        if obs["info"]:
            check_public(self._policy, self._public)
            self._policy.reset(obs["info"])
        action = self._policy.act(obs["observation"])
        return {"actions": np.asarray(action, np.float32), "done": bool(getattr(self._policy, "done", False))}

    def get_action_spec(self) -> dict[str, DimSpec]:
        """As of the benchmark."""
        return {"action": action_spec(self._public.action_space, self._public.control_mode)}

    def get_observation_spec(self) -> dict[str, DimSpec]:
        """As of the benchmark."""
        return {"observation": RAW}
