"""irm by itself: without the robots of the package, without the simulator, from a table of joints."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from irm import ArmChain, JointRow, forward
from irm.errors import ChainError

X, Y, Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
TABLE = [
    JointRow("pan", (0.0, 0.0, 0.4), Z, -2.9, 2.9),
    JointRow("shoulder", (0.0, 0.0, 0.1), Y, -2.0, 2.0),
    JointRow("elbow", (0.4, 0.0, 0.0), Y, -2.6, 2.6),
    JointRow("roll", (0.2, 0.0, 0.0), X, -2.9, 2.9),
    JointRow("flex", (0.2, 0.0, 0.0), Y, -2.0, 2.0),
    JointRow("wrist", (0.0, 0.0, 0.0), X, -3.2, 3.2),
]
ALONE = """
import sys
for name in ("assets", "planners", "clutter_env", "mujoco", "platformdirs", "gymnasium"):
    sys.modules[name] = None
from irm import ArmChain, InverseReachabilityMap, JointRow, ReachabilityMap, decide, tcp_poses
X, Y, Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
rows = {rows!r}
chain = ArmChain.from_joints([JointRow(*row) for row in rows], (0.1, 0.0, 0.0))
print(chain.size, chain.joints)
"""


def test_irm_needs_neither_robots_nor_simulator():
    code = ALONE.format(rows=[tuple(row[:5]) for row in TABLE])
    root = Path(__file__).resolve().parents[2]
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=root)
    assert run.stdout.startswith("7 ('', 'pan'"), run.stderr


def test_a_table_of_joints_is_an_arm():
    chain = ArmChain.from_joints(TABLE, (0.1, 0.0, 0.0))
    np.testing.assert_allclose(forward(chain, np.zeros(7))[:3, 3], (0.9, 0.0, 0.5))
    np.testing.assert_allclose(forward(chain, [0, np.pi / 2, 0, 0, 0, 0, 0])[:3, 3], (0.0, 0.9, 0.5), atol=1e-12)
    lift = JointRow("lift", (0.0, 0.0, 0.0), Z, 0.0, 0.3, True)
    assert ArmChain.from_joints([lift, *TABLE], (0.1, 0.0, 0.0)).upper[0] == 0.3
    for wrong in (TABLE[:5], [*TABLE, lift], [lift._replace(direction=X), *TABLE]):
        with pytest.raises(ChainError):
            ArmChain.from_joints(wrong, (0.1, 0.0, 0.0))
