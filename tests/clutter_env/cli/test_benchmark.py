"""`clutter-env benchmark` prints and saves what it measures."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from clutter_env.cli.main import main


def test_benchmark_prints_and_saves(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    data = tmp_path / "data.json"
    main(["benchmark", "--objects", "3", "--steps", "20", "--json", str(data)])
    assert "| 3 |" in capsys.readouterr().out
    rows = json.loads(data.read_text())["rows"]
    assert [row["objects"] for row in rows] == [3]
    assert all(row["steps_per_s"] > 0 for row in rows)


def test_a_number_of_steps_below_one_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        main(["benchmark", "--objects", "1", "--steps=0"])
    assert end.value.code == 2
    assert "steps=0" in capsys.readouterr().err
