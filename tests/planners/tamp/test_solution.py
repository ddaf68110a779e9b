"""Plans as values: short and long text, equality, files, and the scene of every action."""

from __future__ import annotations

import contextlib
import copy
import dataclasses
import json
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from matplotlib.figure import Figure

from planners import Infeasible, Solution, solve
from planners.cause import Cause
from planners.expert.report import EpisodeReport
from planners.tamp.plan_file import VERSION, PlanFileError, is_same
from tests.planners.own_scenes import kitchen, read
from tests.planners.plans import refused, solved


def test_the_repr_is_one_short_line() -> None:
    long = Infeasible(Cause.UNREACHABLE, "words " * 100, target="name" * 50)
    for result in (solved(), refused(), long):
        assert len(repr(result)) < 200
        assert "\n" not in repr(result)
    assert solved().target in repr(solved())
    assert str(refused().cause) in repr(refused())
    assert len(repr(solved().actions[0])) < 200


def test_the_summary_names_target_clearances_in_order_and_locations() -> None:
    plan = solved()
    text = plan.summary()
    assert plan.target in text.splitlines()[0]
    assert len(plan.clearances) >= 2
    lines = [line for line in text.splitlines() if line.startswith("  ")]
    assert [line.split()[1] for line in lines] == list(plan.clearances)
    for line, action in zip(lines, (a for a in plan.actions if a.is_put_down), strict=True):
        assert action.released is not None
        assert f"x = {action.released.position[0]:.2f} m" in line
        assert action.obstructed in line
    assert f"Actions: {len(plan.actions)}" in text
    assert f"Simulated duration: {plan.duration:.1f} s" in text
    assert "Planning time:" in text
    assert "Replans:" in text


def test_the_summary_of_a_failure_names_cause_and_evidence() -> None:
    text = refused().summary()
    assert f"Cause: {refused().cause}" in text
    assert f"Evidence: {refused().detail}" in text
    assert "object_00" in text.splitlines()[0]


def test_plans_failures_and_reports_are_tables_in_a_notebook() -> None:
    report = EpisodeReport(failure="no plan for <a>")
    for shown, text in ((solved(), solved().summary()), (refused(), refused().summary()), (report, str(report))):
        table = ElementTree.fromstring(shown._repr_html_())
        assert [": ".join(filter(None, (cell.text for cell in row))) for row in table] == text.splitlines()


def test_every_action_keeps_the_scene_that_it_starts_in() -> None:
    plan = solved()
    for action in plan.actions:
        state, start = action.scene.state, action.trajectory
        np.testing.assert_allclose(state.base, start.base[0], atol=1e-6)
        np.testing.assert_allclose(state.q, start.q[0], atol=1e-6)
        assert state.finger_position == pytest.approx(start.finger_position[0])
        held = action.scene.held
        assert (held.name if held else "") == start.phases[0].held
    for action, later in zip(plan.actions, plan.actions[1:], strict=False):
        if action.released is not None:
            placed = later.scene.body(action.target)
            np.testing.assert_allclose(placed.position, action.released.position, atol=1e-6)


def test_a_loaded_plan_equals_the_saved_one_bit_for_bit(tmp_path: Path) -> None:
    plan = solved()
    plan.save(tmp_path / "plan.npz")
    loaded = Solution.load(tmp_path / "plan.npz")
    assert loaded == plan
    assert hash(loaded) == hash(plan)
    for mine, other in zip(plan.actions, loaded.actions, strict=True):
        for name in ("times", "base", "q", "finger_position"):
            one, two = getattr(mine.trajectory, name), getattr(other.trajectory, name)
            assert one.tobytes() == two.tobytes()
            assert not two.flags.writeable
        assert is_same(mine.scene, other.scene)
    assert loaded.summary() == plan.summary()
    assert loaded.stats.history == plan.stats.history


def test_a_plan_among_obstacles_of_any_shape_is_read_again(tmp_path: Path) -> None:
    model, data = kitchen('<geom type="mesh" mesh="wedge" pos="1.3 0.35 0.85"/>')
    plan = solve(read(model, data), "can")
    assert isinstance(plan, Solution), plan
    plan.save(tmp_path / "plan.npz")
    loaded = Solution.load(tmp_path / "plan.npz")
    assert loaded == plan
    shapes = {obstacle.shape for obstacle in loaded.actions[0].scene.static_obstacles}
    assert {"box", "cylinder", "hull"} <= shapes
    plan.plot(Figure().subplots())


def test_a_loaded_failure_equals_the_saved_one(tmp_path: Path) -> None:
    refused().save(tmp_path / "result.npz")
    loaded = Infeasible.load(tmp_path / "result.npz")
    assert loaded == refused()
    assert loaded.cause is refused().cause


def test_plans_that_differ_are_not_equal() -> None:
    plan = solved()
    action = plan.actions[0]
    moved = dataclasses.replace(action.trajectory, q=action.trajectory.q + 1e-12)
    other = dataclasses.replace(action, trajectory=moved)
    assert other != action
    assert dataclasses.replace(plan, actions=(other, *plan.actions[1:])) != plan
    body = action.scene.objects[0]
    elsewhere = dataclasses.replace(action, scene=action.scene.with_body(body.at(body.position + 1e-12)))
    assert elsewhere != action


def parts_of(path: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """The parts of the archive of a saved plan, and its header."""
    solved().save(path)
    with np.load(path) as file:
        parts = dict(file)
    return parts, json.loads(str(parts["header"]))


def write_parts(path: Path, parts: dict[str, Any], header: dict[str, Any]) -> None:
    np.savez(path, **{**parts, "header": np.array(json.dumps(header))})


@pytest.mark.parametrize("version", [2, 4])
def test_an_older_plan_file_is_read(tmp_path: Path, version: int) -> None:
    """Up to version 6 a strategy said how sets of objects are looked at; up to 4 objects had no pieces."""
    path = tmp_path / "plan.npz"
    parts, header = parts_of(path)
    strategy = fields_of(header, "Strategy")
    strategy |= {"sets": 12, "slack": 2, "variations": 6, "second_moves" if version == 2 else "non_monotone": 2}
    bodies = [entry["fields"] for entry in header["objects"] if entry["class"] == "Body"]
    assert [body.pop("pieces") for body in bodies]
    write_parts(path, parts, header | {"version": version})
    assert Solution.load(path) == solved()


def fields_of(header: dict[str, Any], kind: str) -> dict[str, Any]:
    return next(entry["fields"] for entry in header["objects"] if entry["class"] == kind)


BAD_FILES: dict[str, Callable[[Path], object]] = {
    "missing": lambda path: path,
    "text": lambda path: path.write_text("no archive"),
    "empty": lambda path: path.write_bytes(b""),
    "pickled": lambda path: np.savez(path, allow_pickle=True, header=np.array([{"a": 1}], dtype=object)),
    "other archive": lambda path: np.savez(path, numbers=np.arange(3)),
    "failure": lambda path: refused().save(path),
}
BAD_HEADERS: dict[str, Callable[[dict[str, Any]], object]] = {
    "version": lambda header: header.update(version=VERSION + 1),
    "format": lambda header: header.update(format="reachability map"),
    "unknown class": lambda header: header["objects"][0].update({"class": "Popen"}),
    "missing field": lambda header: header["objects"][-1]["fields"].pop("actions"),
    "unknown field": lambda header: header["objects"][-1]["fields"].update(colour="red"),
    "missing array": lambda header: fields_of(header, "Trajectory").update(q={"array": 10**6}),
    "wrong shape": lambda header: fields_of(header, "Body").update(position=fields_of(header, "Body")["quaternion"]),
    "wrong reference": lambda header: header["objects"][0]["fields"].update(name={"object": 10**6}),
}


@pytest.mark.parametrize("kind", [*BAD_FILES, *BAD_HEADERS])
def test_a_bad_file_gives_one_clear_error(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "plan.npz"
    if kind in BAD_FILES:
        BAD_FILES[kind](path)
    else:
        parts, header = parts_of(path)
        BAD_HEADERS[kind](header)
        write_parts(path, parts, header)
    with pytest.raises(PlanFileError, match=r"plan\.npz") as found:
        Solution.load(path)
    assert kind != "failure" or "holds no Solution but 'Infeasible'" in str(found.value)


def assert_refused_or_read(path: Path) -> None:
    """A file is refused with the one error that is declared, or else what is read is a plan."""
    with contextlib.suppress(PlanFileError):
        loaded = Solution.load(path)
        assert isinstance(loaded, Solution)
        assert loaded.summary()


def test_a_file_with_damaged_bytes_gives_the_same_error(tmp_path: Path) -> None:
    """Compression methods that do not exist raised NotImplementedError, enormous shapes MemoryError."""
    path, rng = tmp_path / "plan.npz", np.random.default_rng(0)
    dataclasses.replace(solved(), actions=solved().actions[:1]).save(path)
    content = path.read_bytes()
    directory = content.index(b"PK\x01\x02")
    for turn in range(60):
        broken = bytearray(content)
        first = 0 if turn % 3 else directory  # the archive's directory says how to read everything else
        for place in rng.integers(first, len(content), 1 + turn % 4):
            broken[place] = rng.integers(256)
        path.write_bytes(broken if turn % 5 else broken[: rng.integers(len(broken))])
        assert_refused_or_read(path)
    solved().save(path)
    with zipfile.ZipFile(path) as archive:
        parts = {name: archive.read(name) for name in archive.namelist()}
    shape = b"{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000000,), }"
    parts["array_0.npy"] = b"\x93NUMPY\x01\x00" + len(shape).to_bytes(2, "little") + shape
    with zipfile.ZipFile(path, "w") as archive:
        for name, part in parts.items():
            archive.writestr(name, part)
    with pytest.raises(PlanFileError):
        Solution.load(path)


def test_a_header_with_values_of_wrong_types_gives_the_same_error(tmp_path: Path) -> None:
    path, rng = tmp_path / "plan.npz", np.random.default_rng(0)
    parts, original = parts_of(path)
    wrong = (None, -1, 2.5, "text", [], [1, 2], {}, {"array": 0}, {"object": 0}, {"object": "text"}, True)
    for _ in range(40):
        header = copy.deepcopy(original)
        node: Any = header
        while True:
            keys = list(node) if isinstance(node, dict) else range(len(node))
            key = keys[rng.integers(len(keys))]
            if not isinstance(node[key], dict | list) or not node[key] or rng.random() < 0.1:
                break
            node = node[key]
        node[key] = wrong[rng.integers(len(wrong))]
        write_parts(path, parts, header)
        assert_refused_or_read(path)


def test_what_cannot_be_written_is_named_and_no_file_is_left(tmp_path: Path) -> None:
    plan = dataclasses.replace(solved(), target=object())  # type: ignore[arg-type] # the wrong type is what is tested
    with pytest.raises(PlanFileError, match="object"):
        plan.save(tmp_path / "plan.npz")
    assert not (tmp_path / "plan.npz").exists()
