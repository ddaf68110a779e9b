"""The console command: its overview, help that appears at once, exit codes, and which errors keep their traceback."""

from __future__ import annotations

import importlib
import inspect
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from clutter_env.cli import evaluate
from clutter_env.cli.main import COMMANDS, main
from clutter_env.errors import EXTRAS
from clutter_env.policies.registry import BUILT_IN
from clutter_env.version import version

ROOT = Path(__file__).resolve().parents[3]
HEAVY = ("h5py", "matplotlib", "mujoco", "numba", "planners", "scipy", "torch")
SCRIPT = """
import sys
from clutter_env.cli.main import COMMANDS, main
from clutter_env.version import version
for command in COMMANDS:
    try:
        main([command, *(["check"] if command == "robot" else []), "--help"])
    except SystemExit as end:
        assert not end.code, end.code
main([])
print("heavy:", [name for name in {heavy!r} if name in sys.modules])
"""
POLICY = '''
class Fails:
    """Raises in the given place."""

    def __init__(self):
        if "{where}" == "constructor":
            raise {error}

    def reset(self, info):
        pass

    def act(self, observation):
        raise {error}
'''


def run(*argv: str, folder: Path = ROOT, **options: object) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "PYTHONPATH": f"{ROOT}{os.pathsep}{folder}"}
    command = [sys.executable, "-m", "clutter_env", *argv]
    return subprocess.run(command, capture_output=True, text=True, cwd=folder, env=environment, **options)


def test_help_needs_nothing_heavy() -> None:
    result = subprocess.run(
        [sys.executable, "-c", SCRIPT.format(heavy=HEAVY)], capture_output=True, text=True, cwd=ROOT
    )
    assert result.returncode == 0, result.stderr
    assert "heavy: []" in result.stdout
    assert all(f"  {name} " in result.stdout for name in COMMANDS)


@pytest.mark.parametrize("command", COMMANDS)
def test_examples_in_the_help_keep_their_lines(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Those of `train` ran into one another in one paragraph."""
    with pytest.raises(SystemExit):
        main([command, "--help"])
    lines = {line.strip() for line in capsys.readouterr().out.splitlines()}
    text = importlib.import_module(f"clutter_env.cli.{command}").__doc__ or ""
    examples = {line.strip() for line in text.splitlines() if line.strip().startswith(f"clutter-env {command}")}
    assert examples
    assert examples <= lines


def test_the_version_is_that_of_the_package() -> None:
    assert run("--version").stdout == f"clutter-env {version()}\n"


@pytest.mark.parametrize(
    ("wrong", "hint"),
    [
        ("tabel", "no command 'tabel'; did you mean 'table'?"),
        ("table --objetcs 3", "did you mean '--objects'?"),
        ("table --grasps sdie", "did you mean 'side'?"),
        ("table --objects 61", "--objects 61 is not valid; it must be from 1 to 60"),
        ("episode --layout papr", "did you mean 'paper'?"),
        ("evaluate --suite side-15 --scenes 1", "did you mean 'side-15-v3'?"),
        ("evaluate --policy lokahead --scenes 1", "did you mean 'lookahead'?"),
        ("evaluate --scenes 0", "scenes=0"),
        ("collect --strategy canonicl --env=clutter_env/Retrieve-o1-v0", "did you mean 'canonical'?"),
        ("collect --env=clutter_env/Retreive-o15-v0", "did you mean 'clutter_env/Retrieve-o15-v0'?"),
        ("collect --env=nowhere:Retrieve-v0", "no environment 'nowhere:Retrieve-v0'"),
        ("collect --env=CartPole-v1", "an environment of another package"),
        ("train sac --env CartPole-v1", "clutter-env list environments"),
        ("verify nosuch.json", "nosuch.json cannot be read: No such file or directory"),
        ("compare --envs nothing", "no environment 'nothing'"),
        ("robot check fetch --page page.json", "--page is for an MJCF file"),
        ("robot check robot.xml --page pyproject.toml", "is no JSON file"),
        ("train sac --seed=-1", "--seed -1 is not valid; it must be from 0 to 4294967295"),
        ("compare --envs clutter_env/Retrieve-o5-v0 --scenes 0", "scenes=0 is not valid"),
        ("evaluate --workers 0", "--workers 0 is not valid; it must be at least 1"),
        ("collect --image-size 0 --obs-mode rgbd", "image_size=0 is not valid"),
        ("play --objects 99", "--objects 99 is not valid; valid numbers: 1, 5"),
        ("compare", "name scenes"),
        ("train maskable-po", "did you mean 'maskable-ppo'?"),
        ("--completion fish", "bash, zsh, tcsh"),
    ],
)
def test_wrong_arguments_end_with_code_2_and_a_hint_in_the_last_line(
    wrong: str, hint: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Wrong names and values that an environment or a planner refused ended with code 1, as errors of a run do."""
    with pytest.raises(SystemExit) as end:
        main(wrong.split())
    assert end.value.code == 2
    assert hint in capsys.readouterr().err.splitlines()[-1]


@pytest.mark.parametrize("wrong", ["map --out map.png", "map --tip hand", "robot check x --out x.y"])
def test_what_would_fail_or_be_ignored_after_minutes_is_refused_at_once(wrong: str) -> None:
    """The picture of a map replaced the map; a plot whose ending matplotlib does not know ended with its traceback."""
    with pytest.raises(SystemExit) as end:
        main(wrong.split())
    assert end.value.code == 2


RAY = "ray is not installed; pip install 'clutter-env[distributed]'"


def test_in_a_bare_installation_commands_name_the_extra_that_they_lack(tmp_path: Path) -> None:
    """In the process of a policy too; the traceback of a module of the package's own says nothing to its user."""
    (tmp_path / "sitecustomize.py").write_text(f"""
import sys
__name__ = "importlib"

class Bare:
    def find_spec(self, name, path=None, target=None):
        if name in {set(EXTRAS)}:
            raise ModuleNotFoundError(name, name=name)

sys.meta_path.insert(0, Bare())
""")
    script = """
import sys
from clutter_env.cli.main import main
for command in sys.stdin.read().splitlines():
    try:
        main(command.split())
    except SystemExit as end:
        assert end.code == 1, command
"""
    lacking = {
        "collect": "h5py is not installed; pip install 'clutter-env[data]'",
        "export --to hdf5 --demos none": "h5py is not installed; pip install 'clutter-env[data]'",
        "train sac": "torch is not installed; pip install 'clutter-env[rl]'",
        "play": "torch is not installed; pip install 'clutter-env[rl]'",
        "evaluate --policy keyframes": "torch is not installed; pip install 'clutter-env[rl]'",
        "compare --suites side-15-v3 --policies keyframes": "torch is not installed; pip install 'clutter-env[rl]'",
        "compare --suites side-15-v3 --policies greedy --ray local": RAY,
        "evaluate --policy greedy --ray local": RAY,
    }
    ended = subprocess.run(
        [sys.executable, "-c", script],
        input="\n".join(lacking),
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join((str(tmp_path), str(ROOT)))},
    )
    assert not ended.returncode, ended.stderr
    said = [line for line in ended.stderr.splitlines() if "%|" not in line and "about" not in line]
    assert said == [f"clutter-env {name.split()[0]}: {text}" for name, text in lacking.items()]


def test_shells_complete_commands_and_their_arguments(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        main(["--completion", "bash"])
    assert not end.value.code
    script = capsys.readouterr().out
    assert "warmup" in script
    assert "--time-limit" in script


@pytest.mark.parametrize(
    ("where", "error"),
    [
        ("constructor", '__import__("assets").robot("r2")'),
        pytest.param("act", 'OSError("as told")', marks=pytest.mark.slow),
    ],
)
def test_an_error_in_a_users_policy_keeps_its_traceback(tmp_path: Path, where: str, error: str) -> None:
    """Also one of our own, if it is raised in the user's code."""
    (tmp_path / "mine.py").write_text(POLICY.format(where=where, error=error))
    result = run("evaluate", "--policy", "mine:Fails", "--scenes", "1", "--workers", "1", folder=tmp_path)
    assert result.returncode == 1
    assert "Traceback" in result.stderr
    assert f'mine.py", line {7 if where == "constructor" else 13}' in result.stderr


@pytest.mark.parametrize("policy", ["nosuch:Policy", "json:nosuch", "reach", "sac:nosuch.zip"])
def test_a_wrong_policy_is_refused_before_the_bar_opens(policy: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        main(["evaluate", "--policy", policy])
    assert end.value.code == 2
    said = capsys.readouterr().err
    assert "this takes about" not in said
    assert "0/100" not in said


@pytest.mark.usefixtures("needs_gl")
def test_a_policy_whose_kernels_are_compiled_while_it_plays_is_no_silence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Half a minute of "0 s simulated"."""
    (tmp_path / "compiles.py").write_text(
        """
from numba.core import event


class Policy:
    done = False

    def reset(self, info):
        pass

    def act(self, observation):
        with event.trigger_event("numba:compile"):
            self.done = True
        return [0.0] * 12
"""
    )
    monkeypatch.chdir(tmp_path)
    main(["play", "--objects", "1", "--no-obstructed", "--film", "film", "--policy", "compiles:Policy"])
    assert "compiling the planner's kernels" in caplog.text


def test_errors_of_this_package_have_no_traceback(tmp_path: Path) -> None:
    result = run("evaluate", "--suite", "side-16-v1", folder=tmp_path)
    assert result.returncode == 2, result.stderr
    assert "Traceback" not in result.stderr
    assert result.stderr.splitlines()[-1].startswith("clutter-env evaluate: ")


def test_the_help_names_every_policy() -> None:
    text = inspect.getsource(evaluate.Arguments).replace("\n", " ")
    for name in BUILT_IN:
        assert re.search(rf"\b{name.removesuffix('-all').removesuffix('-shelf')}\b", text), name


def test_ctrl_c_ends_with_code_130_and_says_how_to_go_on(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "clutter_env", "table", "--workers", "1", "--objects", "1", "--out", str(tmp_path)]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    # A shell's background jobs, of which the tests may be one, ignore Ctrl-C, and so do their children.
    before = signal.signal(signal.SIGINT, signal.SIG_DFL)
    try:
        process = subprocess.Popen(
            command, env=environment, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE, start_new_session=True
        )
    finally:
        signal.signal(signal.SIGINT, before)
    assert process.stdout is not None
    process.stdout.readline()  # the workers are being started
    time.sleep(0.5)
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does: the command and its workers
    _, said = process.communicate(timeout=60)
    assert process.returncode == 130, said
    assert "Traceback" not in said
    assert said.splitlines()[-1] == "clutter-env table: interrupted; run the same command again to go on"


def test_another_package_of_the_same_name_is_named(tmp_path: Path) -> None:
    """A user's own `planners.py` hid ours: "cannot import name" said nothing about which file it was."""
    for name, file in (("irm", "irm.py"), ("planners", "planners/__init__.py")):
        other = tmp_path / name / file
        other.parent.mkdir(parents=True)
        other.write_text("")
        hidden = subprocess.run(
            [sys.executable, "-c", "import clutter_env"],
            capture_output=True,
            text=True,
            cwd=tmp_path / name,
            env={**os.environ, "PYTHONPATH": f"{tmp_path / name}{os.pathsep}{ROOT}"},
        )
        assert hidden.returncode == 1
        assert f"ImportError: {other} hides the package {name!r} of clutter-env" in hidden.stderr
