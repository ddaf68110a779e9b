"""The expert in physics: one episode shown in full, or statistics of many.

    clutter-env episode --objects 15
    clutter-env episode --robot pr2 --objects 15
    clutter-env episode --objects 40 --episodes 50 --control-mode joint --grasps all
    clutter-env episode --task stack --objects 8
    clutter-env episode --task search --objects 10

One episode: the plan (Fig. 13 of Lee & Kim 2019), the replanning (Fig. 11), the report, a picture of every choice of
a clearance location (Figs. 8-10), the plan as a file, the episode in 3-D as one page for a browser, and where the
machine can render, a film. Many: the success rate and the causes of failure.
"""

from __future__ import annotations

from clutter_env.cli.episode_arguments import Arguments


def run(arguments: Arguments) -> None:
    """Play one episode or many."""
    from assets import robot as find_robot
    from clutter_env.cli.expert_episodes import count_many, show_one
    from clutter_env.cli.search_episode import show_search
    from clutter_env.reporting.files import write_json
    from clutter_env.reporting.progress import progress_bar
    from irm import cache_folder, cached_map, is_map_at_hand
    from planners import map_parameters

    robot = find_robot(arguments.robot)
    if not is_map_at_hand(robot, **map_parameters(robot)):
        print(f"building the reachability map, once; it is kept in {cache_folder()}", flush=True)
        cached_map(robot, progress=progress_bar, **map_parameters(robot))
    arguments.out.mkdir(parents=True, exist_ok=True)
    shows_retrieve = show_one if arguments.episodes == 1 else count_many
    show = show_search if arguments.task == "search" else shows_retrieve
    figures = show(arguments)
    for path in filter(None, (arguments.out / "report.json", arguments.json)):
        write_json(path, figures)
