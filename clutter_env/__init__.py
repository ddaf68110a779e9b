"""Registers the environments with Gymnasium, and nothing else."""

from gymnasium.envs.registration import WrapperSpec, register

__all__ = ["OBJECT_COUNTS", "SKILL_OBJECT_COUNTS"]

OBJECT_COUNTS = (1, 5, 10, 15, 20, 25, 30, 35, 40, 50, 60)
SKILL_OBJECT_COUNTS = (5, 10, 15, 20)

for _count in OBJECT_COUNTS:
    register(
        id=f"clutter_env/Retrieve-o{_count}-v0",
        entry_point="clutter_env.envs.retrieve:RetrieveEnv",
        kwargs={"num_objects": _count},
        # 300 s, and 20 s more for each object that may have to be cleared first.
        max_episode_steps=6000 + 400 * _count,
    )

for _name in ("Reach", "Pick"):
    register(
        id=f"clutter_env/{_name}-v0",
        entry_point=f"clutter_env.envs.goal:{_name}Env",
        max_episode_steps=100,
        additional_wrappers=(WrapperSpec("GoalInterface", "clutter_env.envs.goal_interface:GoalInterface", {}),),
    )

for _count in SKILL_OBJECT_COUNTS:
    register(
        id=f"clutter_env/Skill-o{_count}-v0",
        entry_point="clutter_env.envs.skill:SkillEnv",
        kwargs={"num_objects": _count},
    )
