"""The certificate table: YES and NO are never wrong, bounds contain every configuration, files are checked."""

import dataclasses

import numpy as np
import pytest

from assets.robots import FETCH
from irm import CertificateTable, cached_map, cached_table, classify, decide, predict
from irm.arm.chain import ArmChain
from irm.arm.exact import exact_solver
from irm.arm.kinematics import forward
from irm.arm.plane_bounds import WristBox
from irm.errors import MapFileError, MapMismatchError, QueryError, ReachabilityError
from irm.maps.cache import cache_file
from irm.maps.certificate.cells import CertificateCells, TableParameters
from irm.maps.certificate.forearm_kernel import forearm_cone
from tests.irm.checks.test_decide import poses_in_ball

NO, UNKNOWN, YES = 0, 1, 2
COARSE = {"width": 0.1, "step": np.radians(20)}


def other_limits(torso, pan):
    """Fetch with other limits of torso and pan, for its closed form."""
    links = list(FETCH.chain)
    links[0] = links[0]._replace(lower=torso[0], upper=torso[1])
    links[1] = links[1]._replace(lower=pan[0], upper=pan[1])
    home = (torso[0], 0.0, *FETCH.home[2:])
    return ArmChain.from_robot(dataclasses.replace(FETCH, name="variant", chain=tuple(links), home=home))


ARMS = {
    "fetch": ArmChain.from_robot(FETCH),
    "no lift": other_limits((0.2, 0.2), (-1.6, 1.6)),
    "short lift": other_limits((0.0, 0.05), (-1.6, 1.6)),
    "pan to one side": other_limits((0.0386, 0.3861), (-0.7, 2.6)),
}


def poses_of_random_configurations(chain, count, rng):
    """Poses in reach, half of them with joints at their limits."""
    low, high = np.maximum(chain.lower, -np.pi), np.minimum(chain.upper, np.pi)
    q = rng.uniform(low, high, size=(count, 8))
    at_limit = (rng.uniform(size=q.shape) < 0.25) & (np.arange(count) % 2 == 0)[:, None]
    q = np.where(at_limit, np.where(rng.uniform(size=q.shape) < 0.5, low, high), q)
    return np.array([forward(chain, one) for one in q])


@pytest.fixture(scope="module")
def table():
    return CertificateTable.build(FETCH)


@pytest.mark.parametrize("name", ARMS)
def test_yes_and_no_are_those_of_the_exact_solver(name):
    chain, rng = ARMS[name], np.random.default_rng(0)
    coarse = CertificateTable.build(chain, **COARSE)
    T = poses_in_ball(20_000, rng)
    answers, truth = classify(coarse, T), exact_solver(chain).solve(T)[0]
    assert np.all(truth[answers == YES] == YES)
    assert np.all(truth[answers == NO] == NO)
    assert np.mean(answers == UNKNOWN) < 0.3
    assert (answers == YES).sum() > 100
    np.testing.assert_array_equal(decide(coarse, T), truth)
    assert not np.any(classify(coarse, poses_of_random_configurations(chain, 4000, rng)) == NO)


def test_accuracy_of_the_table_alone(table):
    T = poses_in_ball(20_000, np.random.default_rng(1))
    truth = exact_solver(table.chain).solve(T)[0] == YES
    answers, likely = classify(table, T), predict(table, T)
    assert np.mean(likely == truth) > 0.99
    assert np.mean(likely[~truth]) < 0.01
    assert np.mean(answers == UNKNOWN) < 0.1
    assert np.all(truth[answers == YES])
    assert not np.any(truth[answers == NO])


def test_a_mirrored_pose_has_the_same_answer(table):
    T = poses_in_ball(2000, np.random.default_rng(2))
    mirrored = T.copy()
    mirrored[:, 1], mirrored[:, :, 1] = -mirrored[:, 1], -mirrored[:, :, 1]
    mirrored[:, 1, 1] = T[:, 1, 1]
    assert np.mean(classify(table, T) == classify(table, mirrored)) > 0.999


def test_every_approach_axis_is_within_the_radius_of_its_cell():
    cells = CertificateCells.of(ARMS["fetch"], TableParameters(**COARSE))
    axes, rings = cells.approach_axes(), len(cells.ring_first) - 1
    rng = np.random.default_rng(3)
    for ring, elevation in enumerate((np.arange(rings)[:, None] + rng.uniform(size=(rings, 50))) * np.pi / rings):
        first, last = cells.ring_first[ring : ring + 2]
        yaw = rng.uniform(0, np.pi, 50)
        own = first + (yaw / np.pi * (last - first)).astype(int)
        up, level = np.sin(elevation - np.pi / 2), np.cos(elevation - np.pi / 2)
        axis = np.column_stack([level * np.cos(yaw), level * np.sin(yaw), up])
        assert np.all(np.arccos(np.clip((axis * axes[own, :3]).sum(axis=1), -1, 1)) <= axes[own, 3])


def test_cones_contain_the_forearms_of_all_configurations():
    """The slow twin: forearms by forward kinematics of configurations whose wrist centre is in a box."""
    chain, rng = ARMS["fetch"], np.random.default_rng(4)
    shoulder_x, upper_arm, forearm = chain.links[[2, 4, 5]]
    inside = 0
    for _ in range(400):
        q = rng.uniform(np.maximum(chain.lower, -np.pi), np.minimum(chain.upper, np.pi))
        lift, roll, elbow = q[2:5]
        up = np.array([[np.cos(lift), 0, np.sin(lift)], [0, 1, 0], [-np.sin(lift), 0, np.cos(lift)]])
        turn = np.array([[1, 0, 0], [0, np.cos(roll), -np.sin(roll)], [0, np.sin(roll), np.cos(roll)]])
        direction = up @ turn @ [np.cos(elbow), 0.0, -np.sin(elbow)]
        wrist = up @ [upper_arm, 0.0, 0.0] + forearm * direction + [shoulder_x, 0.0, 0.0]
        rho, phi = np.hypot(wrist[0], wrist[1]), np.arctan2(wrist[1], wrist[0])
        c, s = np.cos(-phi), np.sin(-phi)
        relative = np.array([c * direction[0] - s * direction[1], s * direction[0] + c * direction[1], direction[2]])
        off = rng.uniform(size=3) * (0.02, 0.05, 0.02)
        box = WristBox(max(0.0, rho - off[0]), rho - off[0] + 0.02, phi - off[1], phi - off[1] + 0.05, 0.0, 0.0)
        box = box._replace(height0=wrist[2] - off[2], height1=wrist[2] - off[2] + 0.02)
        cones = [forearm_cone(chain.links, chain.lower, chain.upper, box, branch, (2, 2, 2)) for branch in range(2)]
        angles = [np.arccos(np.clip(np.dot(relative, (cone.x, cone.y, cone.z)), -1, 1)) for cone in cones]
        assert any(cone.is_possible and angle <= cone.radius for cone, angle in zip(cones, angles, strict=True))
        inside += min(cone.radius for cone in cones) < 0.5
    assert inside > 200


def test_files_are_kept_and_checked(tmp_path, monkeypatch):
    monkeypatch.setenv("CLUTTER_ENV_CACHE", str(tmp_path))
    first = cached_table(FETCH, **COARSE)
    (file,) = tmp_path.iterdir()
    np.testing.assert_array_equal(CertificateTable.load(file, FETCH).arcs, first.arcs)
    with pytest.raises(MapMismatchError, match="variant"):
        CertificateTable.load(file, ARMS["no lift"])
    small = {"voxel": 0.25, "orientations": 6}
    cached_map(FETCH, **small)
    with pytest.raises(MapFileError, match="is no map file"):
        CertificateTable.load(cache_file(FETCH, **small), FETCH)
    file.write_bytes(file.read_bytes()[:300])
    with pytest.raises(MapFileError, match="damaged"):
        CertificateTable.load(file, FETCH)
    np.testing.assert_array_equal(cached_table(FETCH, **COARSE).arcs, first.arcs)


def test_misuse_is_refused(lift_arm, table):
    for bad in ({"width": 0.001}, {"width": "wide"}, {"step": 2.0}, {"step": np.nan}):
        with pytest.raises(ReachabilityError, match="width"):
            CertificateTable.build(FETCH, **bad)
    for chain in (ArmChain.from_robot(lift_arm), other_limits((0.0, 0.3), (-0.5, 0.5))):
        with pytest.raises(ReachabilityError, match="structure of Fetch"):
            CertificateTable.build(chain)
    with pytest.raises(QueryError, match="array"):
        classify(table, "poses")
