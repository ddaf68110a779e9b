"""A complete dataset as a Minari dataset, which `minari.load_dataset` reads."""

from __future__ import annotations

from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any

from gymnasium import spaces

from clutter_env.data.dataset import Dataset
from clutter_env.data.episode_file import episode_arrays
from clutter_env.errors import DatasetError, LearningError, missing_extra
from clutter_env.reporting.files import json_values, written_atomically


def export_minari(dataset: Dataset, root: Path) -> Path:
    """Write the dataset below `root` and return its directory. Minari's own root is $MINARI_DATASETS_PATH or
    ~/.minari/datasets.

    Its name is the environment's id in lower case, such as "clutter_env/retrieve-o15-v0". Infos hold the physics states
    and the labels of the steps. The metadata also hold the provenance, and the names and units of all columns.

    Args:
        dataset: complete.
        root: directory of Minari datasets.

    Raises:
        DatasetError: a dataset of that name exists already, or `dataset` is not complete.
        LearningError: Minari is not installed.
    """
    try:
        import minari
        from minari.data_collector import EpisodeBuffer
        from minari.dataset.minari_storage import MinariStorage
    except ModuleNotFoundError as problem:
        raise LearningError(missing_extra(problem) or str(problem)) from problem
    seeds, identity, task = dataset.seeds, dataset.identity, dataset.task
    dataset_id = task.env_id.lower()
    final = (root / dataset_id).absolute()  # Minari joins relative paths twice
    if final.exists():
        raise DatasetError(f"{final} exists; choose another directory or remove it")
    image_size = identity.get("image_size", 0)
    with written_atomically(final) as part, ExitStack() as stack:
        (part / "data").mkdir(parents=True)
        env: Any = stack.enter_context(closing(task.make()))
        observations = dict(env.observation_space.spaces)
        if image_size:
            with_images: Any = stack.enter_context(closing(task.make(obs_mode="rgbd", image_size=image_size)))
            observations = {**with_images.observation_space.spaces, **observations}
        storage = MinariStorage.new(
            part / "data",
            observation_space=spaces.Dict(observations),
            action_space=env.action_space,
            env_spec=env.spec,
            jpeg_encoding=False,  # lossy
        )
        columns: dict[str, Any] = {}
        for episode in dataset:
            arrays = episode_arrays(episode)
            columns = json_values(episode.columns)
            buffer = EpisodeBuffer(
                seed=episode.seed,
                options=dict(episode.options) if episode.options else None,
                observations=dict(episode.observations),
                infos={name.partition("/")[2]: values for name, values in arrays.items() if name.startswith("infos/")},
                **{name: arrays[name] for name in ("actions", "rewards", "terminations", "truncations")},
            )
            storage.update_episodes([buffer])
        about = f"{len(seeds)} demonstrations of {task.env_id}; each replays bit for bit from its seed and actions."
        metadata = {"dataset_id": dataset_id, "minari_version": minari.__version__, "description": about}
        metadata |= {"algorithm_name": identity["expert"], "provenance": identity.get("provenance"), "columns": columns}
        storage.update_metadata(metadata)
    return final
