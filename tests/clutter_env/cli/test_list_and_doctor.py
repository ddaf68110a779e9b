"""What there is, and whether this installation works."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import gymnasium as gym
import pytest

import clutter_env
from clutter_env.cli import doctor
from clutter_env.cli.main import main


def test_all_names_are_listed_and_each_can_be_used(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    main(["list", "--json", str(tmp_path / "names.json")])
    said, names = capsys.readouterr().out, json.loads((tmp_path / "names.json").read_text())
    assert set(names) == {"environments", "suites", "layouts", "robots", "policies"}
    assert all(name in said for rows in names.values() for name in rows)
    assert list(names["suites"]) == list(clutter_env.suite_names())
    assert all(gym.spec(name) for name in names["environments"])
    assert all(about for rows in names.values() for about in rows.values())


@pytest.mark.parametrize("env_id", ["Retrieve-o5-v0", "ArmPick-v0", "Skill-o5-v0", "Open-v0", "Rearrange-o4-v0"])
def test_a_card_says_what_the_environment_has(env_id: str, capsys: pytest.CaptureFixture[str]) -> None:
    main(["list", f"clutter_env/{env_id}"])
    said = capsys.readouterr().out
    env = gym.make(f"clutter_env/{env_id}")
    space = env.observation_space
    assert f"step limit: {env.spec and env.spec.max_episode_steps}" in said
    assert all(name in said for name in getattr(space, "spaces", {"observation": space}))
    env.close()


@pytest.mark.parametrize(("what", "hint"), [("suits", "'suites'"), ("clutter_env/Retrive-o5-v0", "Retrieve-o5-v0'")])
def test_a_wrong_name_is_answered_with_the_nearest(what: str, hint: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        main(["list", what])
    assert end.value.code == 2
    assert f"did you mean {hint if hint[0] == chr(39) else chr(39) + 'clutter_env/' + hint}" in capsys.readouterr().err


def test_an_installation_that_works_is_said_to_work(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    main(["doctor", "--json", str(tmp_path / "findings.json")])
    said, found = capsys.readouterr().out, json.loads((tmp_path / "findings.json").read_text())
    assert {"numpy", "[rl]", "environment", "planner"} <= {one["name"] for one in found}
    assert not [one for one in found if one["state"] == "broken"]
    assert "works" in said


def test_what_is_missing_or_broken_comes_with_its_cure(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fails() -> str:
        raise RuntimeError("no such luck")

    versions = {"numpy": "1.26.0", "torch": ""}
    whole = doctor._version
    monkeypatch.setattr(doctor, "_version", lambda name: versions.get(name, whole(name)))
    monkeypatch.setattr(doctor, "_plan", fails)
    with pytest.raises(SystemExit) as end:
        main(["doctor"])
    said = capsys.readouterr().out
    assert end.value.code == 1
    assert "broken   numpy          1.26.0" in said
    assert "pip install 'numpy<3,>=2.0'" in said
    assert "pip install 'clutter-env[rl]'" in said
    assert "RuntimeError: no such luck" in said
    assert "does not work: numpy, planner" in said


def test_kernels_that_cannot_be_kept_are_a_finding() -> None:
    code = "from clutter_env.cli.doctor import _kept_kernels; print(*_kept_kernels(), sep='|')"
    environment = {"NUMBA_CACHE_DIR": "/proc/nowhere", "PATH": "/usr/bin", "HOME": "/proc/nowhere"}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("kernels|")
