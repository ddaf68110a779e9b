"""Run by an interpreter that has LeRobot: `load_with_lerobot.py DIRECTORY EXPECTED.npz` compares every item.

EXPECTED holds the features' arrays, all rows, and "video/NAME" for some frames at the rows "video/rows".
"""

from __future__ import annotations

import json
import sys

import numpy as np
from lerobot.datasets.lerobot_dataset import LeRobotDataset

dataset = LeRobotDataset("clutter_env/export", root=sys.argv[1], video_backend="pyav")
expected = np.load(sys.argv[2])
items = [dataset[row] for row in range(len(dataset))]
names = [name for name in expected if not name.startswith("video/")]
same = {
    name: all(np.array_equal(items[i][name].numpy(), expected[name][i]) for i in range(len(items))) for name in names
}
errors = {}
for name in expected:
    if name.startswith("video/observation"):
        frames = np.stack([items[row][name.removeprefix("video/")].numpy() for row in expected["video/rows"]])
        errors[name] = np.abs(frames.transpose(0, 2, 3, 1) * 255 - expected[name]).mean(axis=(1, 2, 3)).tolist()
counts = {"frames": len(dataset), "episodes": dataset.num_episodes, "fps": dataset.fps, "task": items[0]["task"]}
print(
    json.dumps(
        {"same": same, "errors": errors, "keys": sorted(items[0]), "stats": sorted(dataset.meta.stats), **counts}
    )
)
