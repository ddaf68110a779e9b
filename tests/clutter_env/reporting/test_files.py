"""JSON files and Markdown tables."""

from __future__ import annotations

import json
import math
import os
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pytest

from clutter_env.reporting.files import json_text, read_json, write_json
from clutter_env.reporting.intervals import Interval
from clutter_env.reporting.tables import markdown_table, number_text


@dataclass(frozen=True)
class Entry:
    name: str
    share: Interval
    path: Path


def test_json_has_no_nan_and_knows_our_types(tmp_path: Path) -> None:
    entry = Entry("a", Interval(math.nan, -math.inf, 1.0), Path("x/y"))
    write_json(tmp_path / "new" / "f.json", {"entry": entry, 3: MappingProxyType({"n": np.float64("nan")})})
    content = json.loads((tmp_path / "new" / "f.json").read_text(), parse_constant=pytest.fail)
    share = {"mean": None, "low": None, "high": 1.0}
    assert content == {"entry": {"name": "a", "share": share, "path": "x/y"}, "3": {"n": None}}
    assert json_text((np.arange(2), np.bool_(True), None)) == "[[0, 1], true, null]"
    with pytest.raises(TypeError, match="object"):
        json_text({"a": object()})


def test_a_failed_write_leaves_the_old_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "f.json"
    write_json(path, 1)

    def full(_: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", full)
    with pytest.raises(OSError, match="No space left"):
        write_json(path, 2)
    assert [entry.name for entry in tmp_path.iterdir()] == ["f.json"]
    assert path.read_text() == "1"


def test_a_link_or_a_pipe_is_written_to_not_replaced(tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to(tmp_path / "file")
    write_json(tmp_path / "link", 1)
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "file").read_text() == "1"
    os.mkfifo(tmp_path / "pipe")
    reader = os.open(tmp_path / "pipe", os.O_RDONLY | os.O_NONBLOCK)
    write_json(tmp_path / "pipe", 2)
    assert os.read(reader, 10) == b"2"
    os.close(reader)


def test_tables_have_as_many_cells_as_their_head() -> None:
    assert markdown_table(["a", "b"], [["1", "2"]]) == "| a | b |\n| --- | --- |\n| 1 | 2 |\n"
    assert number_text(math.nan) == number_text(None) == "–"
    with pytest.raises(ValueError, match="1 cells"):
        markdown_table(["a", "b"], [["1"]])


@pytest.mark.parametrize("name", ["results.json", "results.json.xz"])
def test_json_is_read_as_it_was_written(tmp_path: Path, name: str) -> None:
    value = {"scores": [0.1, 2, None, "text"], "nested": {"empty": []}}
    write_json(tmp_path / "made" / name, value)
    assert read_json(tmp_path / "made" / name) == value


def test_a_compressed_file_is_smaller_and_a_damaged_one_is_refused(tmp_path: Path) -> None:
    plain, small = tmp_path / "results.json", tmp_path / "results.json.xz"
    for file in (plain, small):
        write_json(file, ["the same words"] * 1000)
    assert small.stat().st_size < plain.stat().st_size / 10
    small.write_bytes(small.read_bytes()[:-20])
    with pytest.raises(ValueError, match="decompress"):
        read_json(small)
