"""Equations 1, 3, 4 and 5, each by itself: laws that they obey."""

import numpy as np

from irm.equations import inverse_reachability, inverse_reachability_on_floor, reachability_map
from irm.rotations import rotation, rotations


def pose(R, p):
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, p
    return T


def test_equation_3_keeps_the_reachable_cells_with_their_best_value():
    cells, mu = reachability_map(np.array([[0.0, 0.2], [0.1, 0.0]], dtype=np.float32))
    np.testing.assert_array_equal(cells, [1, 2])
    np.testing.assert_array_equal(mu, np.float32([0.2, 0.1]))


def test_equation_4_is_the_inverse_transform():
    rng = np.random.default_rng(0)
    R, p = rotations(*rng.uniform(-1.5, 1.5, (3, 20))), rng.normal(size=(20, 3))
    for T_base_tcp, R_base, p_base in zip(map(pose, R, p), *inverse_reachability(R, p), strict=True):
        np.testing.assert_allclose(T_base_tcp @ pose(R_base, p_base), np.eye(4), atol=1e-12)


def test_equation_5_puts_the_base_where_the_tcp_has_yaw_0_and_the_origin_of_the_floor():
    """T_world_base @ T_base_tcp has the TCP above the origin, with its height, pitch and roll, and yaw 0."""
    rng = np.random.default_rng(1)
    x, y, z, yaw, pitch, roll = rng.uniform(-1.5, 1.5, (6, 20))
    for k, base in enumerate(zip(*inverse_reachability_on_floor(x, y, yaw), strict=True)):
        T_world_base = pose(rotation(base[2], 0.0, 0.0), [base[0], base[1], 0.0])
        T_base_tcp = pose(rotation(yaw[k], pitch[k], roll[k]), [x[k], y[k], z[k]])
        expected = pose(rotation(0.0, pitch[k], roll[k]), [0.0, 0.0, z[k]])
        np.testing.assert_allclose(T_world_base @ T_base_tcp, expected, atol=1e-12)
