"""The scripted expert: plans, executes in the simulation, monitors, and replans after deviations."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planners.contact import StepLabel
from planners.execution.config import ExpertConfig
from planners.execution.controlled_env import controlled_env
from planners.execution.episode import Episode
from planners.execution.errors import ExpertError
from planners.execution.report import EpisodeReport
from planners.execution.scene_planner import ScenePlanner, planner_for
from planners.placing.surfaces import Supports
from planners.strategies import Strategy, find_strategy
from planners.tamp.recording import Recording
from planners.tamp.solution import Infeasible, Solution

__all__ = ["EpisodeReport", "ExpertConfig", "ExpertError", "TampExpert"]

Array = NDArray[np.float64]


class TampExpert:
    """A policy for `clutter_env/Retrieve-…` that plans with exact knowledge of all object poses (privileged).

    Example:
        env = gymnasium.make("clutter_env/Retrieve-o15-v0")
        _, info = env.reset(seed=0)
        expert = TampExpert(env)
        expert.reset(info["target"])
        while not expert.done:
            env.step(expert.act())
        print(expert.report)
    """

    def __init__(
        self,
        env: Any,
        strategy: str | Strategy = "lookahead",
        *,
        planner: ScenePlanner | None = None,
        grasps: str | None = None,
        supports: Supports = None,
        canonical: bool | None = None,
        seed: int = 0,
        config: ExpertConfig | None = None,
    ) -> None:
        """Make an expert for an environment; call `reset` to begin an episode.

        Args:
            env: `clutter_env/Retrieve-…`, wrapped or not, or any environment with the `ControlledEnv` protocol. Its
                action space must not be changed by a wrapper.
            strategy: how to clear: a name of `planners.STRATEGIES`, or a `Strategy`.
            planner: a `Planner`, or any object with `solve(scene, target, strategy, rng, time_limit)`, which gets the
                `Strategy`; a new `Planner` if not given.
            grasps: name of the grasp set to choose from: "side", "tilted", "top" or "all"; that of the planner if not
                given, which is "all" for a new one.
            supports: where objects may be put, as for `solve`; for a `Planner` only.
            canonical: whether to plan canonically: the same contacts in similar scenes, without random numbers, every
                phase ending at rest, so that plans can be learned; as the planner does if not given. `report` says
                where it fell back.
            seed: of the planner's sampling; every `reset` starts from it.
            config: limits, tolerances, and whether an obstacle may be held aside.

        Raises:
            ExpertError: an environment, planner or config that cannot be used; the message says why.
            UnknownStrategy: neither the name of a strategy nor a `Strategy`.
            UnknownGraspSet: no grasp set of that name.
            ArmsError: `config.hold_aside` with a robot that acts with one arm.
        """
        if not isinstance(config, ExpertConfig | None):
            raise ExpertError(f"config={config!r} is not valid; it must be an ExpertConfig")
        self._env = controlled_env(env)
        self._strategy = find_strategy(strategy)
        self._config = config or ExpertConfig()
        self._planner = planner_for(self._env, planner, grasps, supports, canonical, self._config.hold_aside)
        self._seed = seed
        self._episode: Episode | None = None

    def reset(self, target: str | None = None) -> None:
        """Read the scene and plan; the environment may be in any state after its own reset.

        Args:
            target: name of the object to retrieve; the environment's own target if not given.

        Raises:
            ExpertError: the environment has not been reset.
            UnknownObject: no object of that name; the episode before goes on.
        """
        try:
            own_target = self._env.target
        except ValueError as error:
            raise ExpertError(f"reset the environment before the expert: {error}") from error
        rng = np.random.default_rng(self._seed)
        wanted = own_target if target is None else target
        self._episode = Episode(self._env, self._planner, self._strategy, self._config, rng, wanted)

    def act(self) -> Array:
        """The next action; call it once before every step of the environment.

        Raises:
            ExpertError: `reset` has not been called since the expert was made or since the environment was reset.
        """
        return self._running("act()").act()

    @property
    def done(self) -> bool:
        """Whether the expert has finished or given up; raises `ExpertError` before `reset`."""
        return self._running("done").done

    @property
    def report(self) -> EpisodeReport:
        """How the episode went, or how it stands; raises `ExpertError` before `reset`."""
        return self._running("report").report

    @property
    def target(self) -> str:
        """Name of the object to retrieve; raises `ExpertError` before `reset`."""
        return self._running("target").target

    @property
    def phase(self) -> str:
        """Action and phase of the motion, for example "PickUp object_03: lift", "" while the robot waits.

        Raises:
            ExpertError: `reset` has not been called.
        """
        return self._running("phase").phase

    @property
    def step_label(self) -> StepLabel:
        """What the last action is part of: phase, contact, and the keyframe at the end of the phase.

        Raises:
            ExpertError: `reset` has not been called.
        """
        return self._running("step_label").step_label

    @property
    def solution(self) -> Solution | Infeasible | None:
        """The result of the last solve; None before `reset`, or if the scene was not valid for planning."""
        return None if self._episode is None else self._episode.solution

    @property
    def recording(self) -> Recording:
        """States, plans and deviations of the episode until now; raises `ExpertError` before `reset`."""
        return self._running("recording").recording

    def to_html(self, path: str | Path) -> None:
        """Write the episode until now as one page for a browser, which needs no network: its motions on a time line.

        Beside the motions: the actions, negative goal regions and candidates of each clearance, base poses of the
        reachability map, planned paths of the gripper, plans after deviations, the report.

        Raises:
            ExpertError: `reset` has not been called.
            OSError: the file cannot be written.
        """
        # The drawing room stands beside this one and imports what planning does not need.
        drawing = importlib.import_module("planners.drawing.page.page")
        report = self.report
        result = "success" if report.result == "success" else "failure"
        drawing.write_page(Path(path), self.recording, {"result": report.result, **report.rows()}, result)

    def _running(self, call: str) -> Episode:
        if self._episode is None:
            raise ExpertError(f"call TampExpert.reset() before {call}")
        return self._episode
