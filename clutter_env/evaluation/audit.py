"""The audit of a suite: the scenes won without looking, and the differences that its scenes can show.

A score says little in three cases. A policy that sees nothing comes near it. Another draw of scenes gives another
score. Or the difference from the next policy is too small for this number of scenes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass

from clutter_env.errors import LearningError
from clutter_env.evaluation.audit_plan import AuditPlan
from clutter_env.evaluation.blind import ROBOT, Demonstrations, Replay, blind, nearest, robot_only
from clutter_env.evaluation.evaluate import Evaluation, evaluate
from clutter_env.evaluation.paired import fewest_won, smallest_shown
from clutter_env.evaluation.resampled import Spread, resampled
from clutter_env.evaluation.scenes import SceneSet
from clutter_env.evaluation.score import play_scene
from clutter_env.policies.protocol import AnyPolicy
from clutter_env.policies.registry import PolicyTraits, policy_families
from clutter_env.reporting.intervals import Interval, wilson

BLIND_SHARE = 0.3
"""Share of the expert's score from which a blind policy shows that a suite does not ask for perception."""


@dataclass(frozen=True)
class Played:
    """One policy of the audit.

    Attributes:
        policy: what it sees, in words.
        clean: clean success on the scenes.
        share: of the expert's success. 0 if the expert has none.
        is_blind: whether it sees nothing of the scene.
    """

    policy: str
    clean: Interval
    share: float
    is_blind: bool


@dataclass(frozen=True)
class Audit:
    """Findings about a suite.

    Attributes:
        suite: its name.
        scenes: number that were played, the first ones of the test split.
        demonstrations: of the expert on the validation split that were clean successes.
        expert: its name, and `expert_clean` its success on the first of the same scenes, as many as the plan says. In
            its demonstrations if the plan says 0.
        played: the policies that see less, or know little.
        spread: over other suites by the same rules. None if none were drawn.
        fewest_won: see `paired.fewest_won`, for this number of scenes.
        shown: the smallest difference below the expert that this number of scenes shows. See `paired.smallest_shown`.
    """

    suite: str
    scenes: int
    demonstrations: int
    expert: str
    expert_clean: Interval
    played: tuple[Played, ...]
    spread: Spread | None
    fewest_won: int | None
    shown: float | None

    @property
    def is_blind(self) -> bool:
        """Whether a policy that sees nothing of the scene reaches `BLIND_SHARE` of the expert's score."""
        return any(one.is_blind and one.share >= BLIND_SHARE for one in self.played)


def audit(suite: str, plan: AuditPlan, tick: Callable[[], object] = lambda: None) -> Audit:
    """Play a suite with policies that see less and less, and say what its scenes can show.

    Args:
        suite: name of a suite.
        plan: how much is played.
        tick: called after every episode.

    Raises:
        SuiteError: there is no such suite.
        LearningError: the expert cannot play it, or has no clean success.
    """
    scenes = SceneSet(suite, count=plan.scenes)
    if scenes.family not in policy_families(plan.expert):
        raise LearningError(f"{plan.expert} cannot play {scenes.name} ({scenes.family}): name another --expert")

    def demonstrated(on: SceneSet) -> Evaluation:
        return evaluate(plan.expert, on, workers=plan.workers, tick=tick)

    demonstrations = demonstrated(SceneSet(suite, "validation", count=plan.demonstrations))
    count = expert_scenes(plan)
    expert = demonstrated(SceneSet(suite, count=count)).clean if count else demonstrations.clean
    known = Demonstrations.of(demonstrations)
    played, outcomes = [], Outcomes(scenes)
    for name, policy, is_blind in _policies(known, plan.network):
        clean = wilson(outcomes.wins(policy, tick), plan.scenes)
        played.append(Played(name, clean, clean.mean / expert.mean if expert.mean else 0.0, is_blind))
    spread = None
    if plan.suites:
        spread = resampled(plan.spread_policy or plan.expert, suite, plan.suites, plan.scenes, plan.workers, tick)
    return Audit(
        suite=suite,
        scenes=plan.scenes,
        demonstrations=len(known.actions),
        expert=plan.expert,
        expert_clean=expert,
        played=tuple(played),
        spread=spread,
        fewest_won=fewest_won(plan.scenes),
        shown=smallest_shown(plan.scenes, expert.mean),
    )


class Outcomes:
    """The scenes that the policies of an audit win.

    They play in this process, and are scored as they play. They are the package's own policies. So the replay in
    another process that `evaluate` makes of every episode would only double the time. If several of them play the same
    demonstration in a scene, it is played once.
    """

    def __init__(self, scenes: SceneSet) -> None:
        self._scenes = scenes
        self._known: dict[tuple[int, bytes], bool] = {}

    def wins(self, policy: AnyPolicy, tick: Callable[[], object] = lambda: None) -> int:
        """Number of scenes that a policy wins."""
        won = 0
        with closing(self._scenes.scenes[0].make(**PolicyTraits.of(policy).env_keywords)) as env:
            for scene in self._scenes.scenes:
                if not isinstance(policy, Replay):
                    won += play_scene(scene, env, policy).clean
                else:
                    key = (scene.seed, policy.chosen(scene.reset(env)[0]).tobytes())
                    if key not in self._known:
                        self._known[key] = play_scene(scene, env, policy).clean
                    won += self._known[key]
                tick()
        return won


def expert_scenes(plan: AuditPlan) -> int:
    """Number of test scenes that the expert plays."""
    return plan.scenes if plan.expert_scenes is None else min(plan.expert_scenes, plan.scenes)


def episodes_of(plan: AuditPlan) -> int:
    """Number of episodes that an audit plays."""
    policies = 3 + 3 * plan.network + plan.suites
    return policies * plan.scenes + expert_scenes(plan) + plan.demonstrations


def _policies(known: Demonstrations, network: bool) -> Iterator[tuple[str, AnyPolicy, bool]]:
    """Name, policy, and whether it sees nothing of the scene."""
    yield "blind: one sequence of actions", blind(known), True
    yield "sees the robot: the demonstration with the likest robot", robot_only(known), True
    yield "sees all: the demonstration with the likest scene", nearest(known), False
    if network:
        from clutter_env.evaluation.small_network import SmallNetwork  # needs torch

        own = [name for name in ROBOT if name in known.first[0]]
        yield "network, observations zeroed", SmallNetwork(known, ()), True
        yield "network that sees the robot", SmallNetwork(known, own), True
        yield "network that sees all", SmallNetwork(known, tuple(known.first[0])), False
