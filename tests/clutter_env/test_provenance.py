"""Records of what a file was made with: what changes them, and what they say."""

from __future__ import annotations

import json
import os
import platform
import subprocess
import sys
import tomllib
from contextlib import closing
from pathlib import Path

import gymnasium as gym
import pytest

import clutter_env
from clutter_env import provenance as module
from clutter_env.provenance import differences, environment_digest, provenance

ROOT = Path(__file__).resolve().parents[2]
ENV_ID = "clutter_env/Retrieve-o5-v0"
CPU = Path("/proc/cpuinfo")
HAS_FMA = platform.libc_ver()[0] == "glibc" and CPU.exists() and " fma " in CPU.read_text()


def test_the_version_stands_in_one_place() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert clutter_env.__version__ == provenance()["version"] == project["version"]


def test_a_record_survives_json_and_does_not_differ_from_itself() -> None:
    record = provenance(ENV_ID)
    assert differences(json.loads(json.dumps(record)), record) == []
    assert "0.1" in differences(None, record)[0]


@pytest.mark.parametrize(
    ("keywords", "said"),
    [
        ({"layout": "shelf"}, "layout='paper'"),
        ({"max_episode_steps": 7}, "time limit has changed: 1500, now 7"),
        ({"success": "lifted"}, "success='clean'"),
        ({"head": "commanded"}, "head=None; this one has 'commanded'"),
    ],
)
def test_other_settings_are_named(keywords: dict[str, object], said: str) -> None:
    env = gym.make(ENV_ID, **keywords)
    assert any(said in sentence for sentence in differences(provenance(ENV_ID), provenance(env)))
    env.close()


def test_pictures_do_not_matter() -> None:
    env = gym.make(ENV_ID, camera="top", width=64)
    assert environment_digest(env) == environment_digest(ENV_ID)
    env.close()


def test_images_of_primitives_are_not_those_of_meshes(monkeypatch: pytest.MonkeyPatch) -> None:
    records = []
    for has_meshes in (False, True):
        monkeypatch.setattr(module, "has_visuals", lambda _robot, there=has_meshes: there)
        with closing(gym.make(ENV_ID)) as plain, closing(gym.make("clutter_env/Search-o5-v0")) as search:
            records.append((provenance(plain), provenance(search)))
    (state, seen), (same_state, other) = records
    assert state == same_state
    assert differences(json.loads(json.dumps(seen)), other) == [
        "The environment's robot in images has changed: primitives, now meshes."
    ]
    del seen["environment"]["robot in images"]  # recorded before it was noted
    assert differences(seen, other) == []


def test_other_versions_and_commits_are_named() -> None:
    present = provenance()
    old = {**present, "version": "0.1.9", "commit": "abc"}
    assert ["0.1.9" in differences(old, present)[0], "abc" in differences(old, present)[1]] == [True, True]
    assert differences({**present, "commit": "abc"}, present) == []


def test_code_counts_but_comments_do_not(tmp_path: Path) -> None:
    first, second, third = (tmp_path / name for name in ("a.py", "b.py", "c.py"))
    first.write_text('def f(x):\n    """Twice."""\n    return 2 * x\n')
    second.write_text('"""A file."""\n\n\ndef f(x):  # a comment\n    return (2 * x)\n')
    third.write_text("def f(x):\n    return 3 * x\n")
    digests = [module._code_digest(str(file)) for file in (first, second, third)]
    assert digests[0] == digests[1] != digests[2]


def test_every_file_with_rules_exists() -> None:
    assert all((ROOT / "clutter_env" / file).is_file() for files in module._RULES.values() for file in files)


@pytest.mark.slow
@pytest.mark.skipif(not HAS_FMA, reason="no C library with FMA")
def test_a_c_library_without_fma_is_another_arithmetic() -> None:
    tunables = "glibc.cpu.hwcaps=-AVX2,-FMA,-AVX512F,-AVX"
    code = "from clutter_env.provenance import provenance; print(provenance()['arithmetic'])"
    found = subprocess.run(
        [sys.executable, "-c", code], env={**os.environ, "GLIBC_TUNABLES": tunables}, capture_output=True, check=True
    )
    assert found.stdout.decode().strip() != provenance()["arithmetic"]
