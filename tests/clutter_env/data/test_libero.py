"""Demonstrations in LIBERO's layout as a LeRobot dataset, read back."""

from __future__ import annotations

import json
from pathlib import Path

import h5py
import numpy as np
import pytest

from clutter_env.cli.main import main
from clutter_env.data.libero import export_libero
from clutter_env.errors import DatasetError

LENGTHS, SIZE = (5, 8), 64


def _file(path: Path) -> Path:
    """Two demonstrations; images are bright in their first rows and columns, which are below and on the right."""
    rng = np.random.default_rng(0)
    with h5py.File(path, "w") as content:
        data = content.create_group("data")
        data.attrs["problem_info"] = json.dumps({"language_instruction": "put the bowl on the stove"})
        for number, length in enumerate(LENGTHS):
            demo = data.create_group(f"demo_{number}")
            demo["actions"] = rng.uniform(-1, 1, (length, 7))
            demo["rewards"] = demo["dones"] = (np.arange(length) == length - 1).astype(np.uint8)
            for name, width in (("ee_states", 6), ("gripper_states", 2)):
                demo[f"obs/{name}"] = rng.normal(size=(length, width))
            images = np.zeros((length, SIZE, SIZE, 3), np.uint8)
            images[:, : SIZE // 2, : SIZE // 2] = 200
            for name in ("agentview_rgb", "eye_in_hand_rgb"):
                demo[f"obs/{name}"] = images
    return path


def test_a_file_of_liberos_is_read_back_from_lerobots_format(tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    av = pytest.importorskip("av")
    file, out = _file(tmp_path / "demos.hdf5"), tmp_path / "out"
    assert export_libero(file, out) == len(LENGTHS)
    info = json.loads((out / "meta/info.json").read_text())
    assert (info["codebase_version"], info["fps"], info["total_episodes"]) == ("v3.0", 20, 2)
    assert info["total_frames"] == sum(LENGTHS) - len(LENGTHS)
    assert info["features"]["observation.state"]["shape"] == [8]
    tasks = parquet.read_table(out / "meta/tasks.parquet")
    assert "put the bowl on the stove" in tasks.to_pylist()[0].values()
    rows = parquet.read_table(out / "data/chunk-000/file-000.parquet").to_pylist()
    with h5py.File(file) as content:
        for number in range(len(LENGTHS)):
            demo, own = content[f"data/demo_{number}"], [row for row in rows if row["episode_index"] == number]
            np.testing.assert_allclose([row["action"] for row in own], demo["actions"][1:], rtol=1e-6)
            # What was seen after an action is what was seen before the next.
            np.testing.assert_allclose(
                [row["observation.state"][:6] for row in own], demo["obs/ee_states"][:-1], rtol=1e-6
            )
            assert [row["next.success"] for row in own] == [False] * (len(own) - 1) + [True]
    for camera in ("image", "image2"):
        with av.open(str(out / f"videos/observation.images.{camera}/chunk-000/file-000.mp4")) as video:
            frames = [one.to_ndarray(format="rgb24") for one in video.decode(video=0)]
        assert len(frames) == info["total_frames"]
        assert frames[0][3 * SIZE // 4, 3 * SIZE // 4].min() > 150
        assert frames[0][SIZE // 4, SIZE // 4].max() < 50


def test_the_command_exports_a_file_of_liberos_to_lerobot_alone(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("pyarrow")
    file, out = _file(tmp_path / "demos.hdf5"), tmp_path / "out"
    main(["export", "--demos", str(file), "--to", "lerobot", "--out", str(out)])
    assert "2 episodes in" in capsys.readouterr().out
    with pytest.raises(DatasetError, match="exists"):
        export_libero(file, out)
