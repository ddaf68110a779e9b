"""What the joints certainly do not reach: never a pose of a configuration, of any arm."""

from __future__ import annotations

import numpy as np
import pytest

from irm.chain import ArmChain, JointRow, chain_arrays
from irm.ik.outer_reach import are_out_of_reach
from irm.map_kernels import tcp_frames
from tests.irm.arms import random_configurations


def random_arm(seed):
    """Six or seven joints with random axes, offsets and limits, every second time on a lift."""
    rng = np.random.default_rng(seed)
    rows = [JointRow("lift", (0.1, 0.0, 0.3), (0.0, 0.0, 1.0), 0.1, 0.4, True)] if seed % 2 else []
    for k in range(6 + seed % 3 // 2):
        axis, low = rng.normal(size=3), rng.uniform(-3.0, 0.0)
        offset = rng.normal(scale=0.15, size=3) * (rng.random(3) < 0.6)
        rows.append(JointRow(f"joint{k}", offset, axis / np.linalg.norm(axis), low, low + rng.uniform(0.5, 6.5)))
    return ArmChain.from_joints(rows, (0.1, 0.05, 0.0))


def poses(chain, q):
    T = np.tile(np.eye(4), (len(q), 1, 1))
    T[:, :3, :3], T[:, :3, 3] = tcp_frames(chain_arrays(chain), q)
    return T


@pytest.mark.parametrize("seed", range(3))
def test_no_pose_of_a_configuration_is_out_of_reach(seed):
    chain, rng = random_arm(seed), np.random.default_rng(seed)
    q = np.concatenate([random_configurations(chain, 8_000, rng, near_limits) for near_limits in (False, True)])
    right_angles = np.clip(np.round(q[:2000] * 2 / np.pi) * np.pi / 2, chain.lower, chain.upper)
    right_angles[:, 0] = q[:2000, 0]
    T = poses(chain, np.concatenate([q, right_angles]))
    assert not are_out_of_reach(chain, (float(chain.lower[0]), float(chain.upper[0])), T).any()
    T[:, 0, 3] += 2.1 * chain.reach
    assert are_out_of_reach(chain, (float(chain.lower[0]), float(chain.upper[0])), T).all()
