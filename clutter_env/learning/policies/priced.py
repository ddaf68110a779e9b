"""A replay buffer with hindsight in whose rewards distance and motion have a price."""

from __future__ import annotations

from typing import Any

from stable_baselines3 import HerReplayBuffer
from stable_baselines3.common.type_aliases import DictReplayBufferSamples

from clutter_env.envs.goal import GOAL_TOLERANCE

__all__ = ["DISTANCE_PRICE", "MOTION_PRICE", "NEAR_PRICE", "PricedReplayBuffer"]

MOTION_PRICE = 5.0
"""What a step at full speed in every direction costs. Of the gripper at full speed in its three it costs 1.5, less than
being away from the goal for that step, 2.25 and more: the fastest way to the goal stays the best one."""
DISTANCE_PRICE = 5.0
"""[1/m] What a step at a distance from the goal costs."""
NEAR_PRICE = 20.0
"""[1/m] What a step at a distance up to `GOAL_TOLERANCE` costs in addition. A step of 15 mm within the tolerance is
then worth 0.4 a step, which the critics can tell from their errors of about 1, and not 0.08."""


class PricedReplayBuffer(HerReplayBuffer):
    """Takes the prices off every reward, those of relabelled goals included: `MOTION_PRICE` times the mean square of
    the action, `DISTANCE_PRICE` times the distance from the goal after it, and within the goal's tolerance `NEAR_PRICE`
    times that distance, beyond it `NEAR_PRICE` times the tolerance.

    Within the goal's tolerance the sparse reward is the same everywhere and for every action. A learner of it stops
    anywhere in there, turns and drives on, until the arm is at the end of its range and leaves the goal again, beyond
    the horizon of the discount. With the prices it is best to go to the middle and to stand still. (Plappert et al.
    2018, Multi-goal reinforcement learning, penalise the squares of the actions in the loss of the actor.)
    """

    def sample(self, batch_size: int, env: Any = None) -> DictReplayBufferSamples:
        """A batch with the lower rewards."""
        drawn = super().sample(batch_size, env)
        reached = drawn.next_observations
        away = (reached["achieved_goal"] - reached["desired_goal"]).float().norm(dim=1, keepdim=True)
        motion = drawn.actions.square().mean(dim=1, keepdim=True)
        price = MOTION_PRICE * motion + DISTANCE_PRICE * away + NEAR_PRICE * away.clamp(max=GOAL_TOLERANCE)
        return drawn._replace(rewards=drawn.rewards - price)
