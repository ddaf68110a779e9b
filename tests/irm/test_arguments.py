"""Keyword arguments of the queries: one set for all of them, checked in one place."""

import itertools

import numpy as np
import pytest

from irm import ExactSolver, query_tolerant, tcp_poses, verify
from irm.errors import QueryError
from irm.inverse_map import ClassicalInverseReachabilityMap
from irm.query_kernels import base_turns
from irm.query_keys import YawWindow
from irm.rotations import rotation

POSITION = (0.0, 0.0, 0.9)


@pytest.fixture(scope="module")
def queries(coarse_map, coarse_inverse):
    """Every public query with its first argument given."""
    classical = ClassicalInverseReachabilityMap(coarse_map)
    return {
        "yaw_range": lambda **keywords: coarse_inverse.query(POSITION, **keywords),
        "target, solids, yaw_range": lambda **keywords: coarse_inverse.query_path([POSITION], **keywords),
        "yaw_ranges": lambda **keywords: coarse_inverse.query_batch(POSITION, **keywords),
        "yaw_ranges, pitch": lambda **keywords: coarse_inverse.query_multi([POSITION], **keywords),
        "yaw_range, pitch": lambda **keywords: classical.query(POSITION, **keywords),
    }


def test_a_wrong_value_is_refused_after_an_equal_one_of_the_right_kind(coarse_inverse):
    assert len(coarse_inverse.query(POSITION, k=1, exact=True)) == 1
    for wrong in ({"k": True, "exact": True}, {"k": 1.0}, {"k": 1, "exact": 1}):
        with pytest.raises(QueryError):
            coarse_inverse.query(POSITION, **wrong)


BAD_VALUES = [
    *(({"k": bad}, "at least 1") for bad in (0, 1.5, "many", np.nan, [], None, True, np.array([1, 2]))),
    *(({"pitch": bad}, "finite number") for bad in (np.nan, "level", None, np.array([0.1, 0.2]), 10**400)),
    *(({"separation": bad}, "separation") for bad in (np.nan, -0.1, None)),
    *(({"yaw_step": bad}, "yaw_step") for bad in (0.0, np.inf, np.array([0.1, 0.2]))),
    ({"k": 10**12}, "at most 100000"),
    ({"yaw_step": 1e-9}, "yaw_step must be at least 0.001"),
    ({"roll": np.inf}, "finite"),
    ({"exact": "yes"}, "exact is True, False or None"),
    ({"free_space": [(0, 0, 1, 1)]}, "FreeSpace or None, not list"),
]


@pytest.mark.parametrize(("keywords", "message"), BAD_VALUES, ids=lambda value: str(value))
def test_values_without_meaning_are_refused_by_every_query(queries, keywords, message):
    for query in queries.values():
        with pytest.raises(QueryError, match=message):
            query(**keywords)


def test_a_keyword_that_no_query_has_is_refused_with_those_there_are(queries):
    for query in queries.values():
        with pytest.raises(TypeError, match=r"'pich'; they have pitch, roll, free_space"):
            query(pich=0.1)


def test_the_classical_map_decides_nothing_exactly(coarse_map):
    with pytest.raises(QueryError, match="InverseReachabilityMap"):
        ClassicalInverseReachabilityMap(coarse_map).query(POSITION, exact=True)


def test_numbers_of_numpy_are_numbers(coarse_inverse):
    plain = coarse_inverse.query(POSITION, pitch=0.0, k=2, separation=0.2)
    numpy = coarse_inverse.query(POSITION, pitch=np.array(0.0), k=np.int64(2), separation=np.float32(0.2))
    np.testing.assert_array_equal(plain.poses, numpy.poses)


def test_yaw_ranges_that_are_no_pairs_are_refused(coarse_inverse):
    for query in (coarse_inverse.query_batch, coarse_inverse.query_multi):
        for bad in ((0.0, 1.0, 2.0), [[0.0], [1.0]], "all", [[(0.0, 1.0)]]):
            with pytest.raises(QueryError, match="pairs of numbers"):
                query([POSITION], yaw_ranges=bad)
        with pytest.raises(QueryError, match="longer than"):
            query([POSITION], yaw_ranges=(0.0, 7.0))
        with pytest.raises(QueryError, match="finite"):
            query([POSITION], yaw_ranges=(0.0, np.nan))


def test_positions_that_are_no_numbers_are_refused(coarse_inverse):
    for query in (coarse_inverse.query_batch, coarse_inverse.query_multi, coarse_inverse.query_path):
        with pytest.raises(QueryError, match="positions are an array"):
            query([("a", "b", "c")])


def test_positions_so_far_away_that_numbers_are_coarse_are_refused(coarse_inverse, coarse_map):
    """At 1e17 m every base is the TCP's place, and was certain."""
    T = np.eye(4)
    for far in ((1e17, 0.0, 0.9), (0.0, -1e8, 0.9)):
        T[:3, 3] = far
        classical = ClassicalInverseReachabilityMap(coarse_map)
        for query in (coarse_inverse.query, classical.query):
            for position in (far, T):
                with pytest.raises(QueryError, match="at most 1e\\+07 m"):
                    query(position)
        for query in (coarse_inverse.query_batch, coarse_inverse.query_multi, coarse_inverse.query_path):
            with pytest.raises(QueryError, match="at most 1e\\+07 m"):
                query([far])
        with pytest.raises(QueryError, match="at most 1e\\+07 m"):
            coarse_inverse.query_batch(T[None])
    assert len(coarse_inverse.query((5e6, 3e5, 0.9))), "map coordinates"


def test_a_step_longer_than_a_turn_is_one(coarse_inverse):
    """1e300 ended in a division by zero."""
    turn = coarse_inverse.query(POSITION, yaw_step=2 * np.pi, k=3)
    np.testing.assert_array_equal(coarse_inverse.query(POSITION, yaw_step=1e300, k=3).poses, turn.poses)


def test_a_range_of_pitches_is_one_of_pitches(coarse_inverse):
    """Its ends were cut, though a single pitch beyond them is refused."""
    for wrong in ((0.0, 10.0), (-2.0, 0.0), (2.0, 3.0)):
        with pytest.raises(QueryError, match="range of pitches lies in"):
            coarse_inverse.query(POSITION, pitch=wrong)
    assert coarse_inverse.query(POSITION, pitch=(-np.pi / 2, np.pi / 2))


def test_arms_are_maps_of_equation_5(coarse_inverse, coarse_map):
    for arms in (coarse_inverse, (coarse_inverse, ClassicalInverseReachabilityMap(coarse_map)), "ab"):
        with pytest.raises(QueryError, match="arms are a sequence of InverseReachabilityMap"):
            coarse_inverse.query_multi([POSITION, POSITION], arms=arms)


def test_poses_that_are_none_are_refused_by_the_solver_too(coarse_map):
    """A reflection was reachable, and rotations alone (n, 3, 3) were out of reach."""
    solver, mirror = ExactSolver(coarse_map.chain), np.eye(4)
    mirror[:3, :3], mirror[:3, 3] = np.diag([1.0, 1.0, -1.0]), (0.6, 0.0, 0.8)
    for solve in (solver.solve, solver.reach):
        for wrong in (mirror[None], 2 * np.eye(4)[None], np.eye(3)[None], np.full((1, 4, 4), np.nan), np.eye(4), None):
            with pytest.raises(QueryError):
                solve(wrong)
        assert len(solve(np.empty((0, 4, 4)))[0]) == 0
    for heights in ((1.0, 0.0), (np.nan, 1.0), (0.0, np.inf)):
        with pytest.raises(QueryError, match="torso_range"):
            ExactSolver(coarse_map.chain, heights)


def test_other_functions_refuse_what_is_no_number(coarse_inverse, coarse_map):
    rng, small = np.random.default_rng(0), 1e-4 * np.eye(3)
    for position, keywords in ((np.eye(4), {}), ((0.0, np.nan, 1.0), {}), (POSITION, {"k": "many"})):
        with pytest.raises(QueryError):
            query_tolerant(coarse_inverse, position, small, rng, **keywords)
    with pytest.raises(QueryError, match="finite"):
        tcp_poses(POSITION, np.nan)
    with pytest.raises(QueryError, match="finite"):
        verify(coarse_map, coarse_inverse.query(POSITION), lambda _: np.full((1, 4, 4), np.nan))


def test_approach_yaws_cover_the_range_in_steps():
    for (low, high), step in itertools.product([(0.0, 1.0), (-0.2, 0.2), (-np.pi, np.pi)], [0.05, 0.3, 2.0]):
        yaws = base_turns(YawWindow(low, high, step, 4, 0.0))
        assert np.all(np.diff(yaws) <= step + 1e-9)
        assert yaws[0] >= low
        assert yaws[-1] <= high


def test_a_pose_stands_for_its_position_and_angles(coarse_inverse, coarse_map):
    yaw, pitch = 0.4, 0.2
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotation(yaw, pitch, 0.0), (0.1, 0.0, 0.82)
    for queries in (coarse_inverse, ClassicalInverseReachabilityMap(coarse_map)):
        found = queries.query(T, k=3)
        same = queries.query((0.1, 0.0, 0.82), yaw_range=(yaw, yaw), pitch=pitch, k=3)
        assert len(found) == 3
        np.testing.assert_allclose(found.poses, same.poses, atol=1e-9)
        with pytest.raises(QueryError, match="without pitch, yaw_range"):
            queries.query(T, pitch=0.0, yaw_range=(-0.5, 0.5))
        with pytest.raises(QueryError, match="not a rotation"):
            queries.query(2 * T)


def test_an_answer_prints_as_a_table_and_shows_one_in_a_notebook(coarse_inverse):
    for answer in (
        coarse_inverse.query((0.1, 0.0, 0.82), k=3),
        coarse_inverse.query((9.0, 0.0, 9.0)),
        coarse_inverse.query_multi([(0.1, 0.0, 0.82), (0.1, 0.1, 0.82)], k=2),
    ):
        status, names, *rows = str(answer).splitlines()
        assert status.strip() == str(answer.status)
        assert "yaw [rad]" in names
        assert [float(row.split()[0]) for row in rows] == pytest.approx(answer.poses[:, 0], abs=1e-3)
        assert answer._repr_html_().count("<tr>") == 1 + len(answer)


def test_an_approach_that_is_nearly_vertical_keeps_to_its_yaws(coarse_inverse):
    """Nearer to the pole than to a ring, every yaw was tried: bases were certain for poses that were not asked for."""
    for exact in (None, False, True):
        found = coarse_inverse.query((0.1, 0.0, 0.8), pitch=1.35, yaw_range=(0.2, 0.4), k=5, exact=exact)
        assert len(found)
        assert np.all((found.approach_yaw >= 0.2 - 1e-6) & (found.approach_yaw <= 0.4 + 1e-6))
