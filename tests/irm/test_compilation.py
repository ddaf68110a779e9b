"""Kernels compile where nothing can be written."""

from __future__ import annotations

import os
import pickle
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numba
import pytest
from numba.core import config, event

from irm.compilation import njit
from irm.free_space import classify_cells

ROOT = Path(__file__).resolve().parents[2]
WITHOUT_PRIVILEGE = ("setpriv", "--bounding-set=-dac_override", "--inh-caps=-all")
"""Root may write everything; without this capability, permissions hold for root too."""


@pytest.fixture(scope="module")
def read_only_install() -> Iterator[Path]:
    """The packages in a folder that the user of `run_there` cannot write."""
    folder = Path(tempfile.mkdtemp())
    folder.chmod(0o755)
    for package in ("assets", "irm", "planners", "clutter_env"):
        shutil.copytree(ROOT / package, folder / package, ignore=shutil.ignore_patterns("__pycache__"))
    (folder / "home").mkdir()
    for place in (folder, *folder.rglob("*")):
        place.chmod(0o555 if place.is_dir() else 0o444)
    yield folder
    for place in (folder, *(entry for entry in folder.rglob("*") if entry.is_dir())):
        place.chmod(0o755)
    shutil.rmtree(folder)


def run_there(folder: Path, code: str, **variables: str) -> subprocess.CompletedProcess[str]:
    """Run code as a user who can write neither the packages nor the home directory."""
    drop = () if os.geteuid() else WITHOUT_PRIVILEGE
    if drop and shutil.which(drop[0]) is None:
        pytest.skip("root without setpriv: permissions do not hold")
    kept = {name: value for name, value in os.environ.items() if name in ("PATH", "LANG", "LC_ALL")}
    settings = {"HOME": str(folder / "home"), "PYTHONPATH": str(folder), "PYTHONDONTWRITEBYTECODE": "1"}
    return subprocess.run(
        [*drop, sys.executable, "-c", code],
        capture_output=True,
        text=True,
        cwd="/",
        env={**kept, **settings, **variables},
    )


PLAIN_NUMBA = """
import numba, assets.robots
exec(compile("def f(x):\\n    return x", assets.robots.__file__, "exec"))
numba.njit(cache=True)(f)
"""
USE = """
import irm, planners, clutter_env.envs.skill
print(irm.FreeSpace.from_boxes([(0, 0, 1, 1)], 0.3).is_free(1.0, 1.0))
"""


@pytest.mark.slow
def test_numba_itself_refuses_there(read_only_install: Path) -> None:
    """Otherwise the next test shows nothing."""
    result = run_there(read_only_install, PLAIN_NUMBA)
    assert "cannot cache function" in result.stderr, result.stderr


@pytest.mark.slow
def test_packages_import_and_compile_with_one_warning(read_only_install: Path) -> None:
    result = run_there(read_only_install, USE)
    assert result.returncode == 0, result.stderr
    assert result.stderr.count("NUMBA_CACHE_DIR") == 1, result.stderr


@pytest.mark.slow
def test_the_directory_that_the_warning_asks_for_is_used(read_only_install: Path) -> None:
    with tempfile.TemporaryDirectory() as cache:
        result = run_there(read_only_install, USE, NUMBA_CACHE_DIR=cache)
        assert result.returncode == 0, result.stderr
        assert "NUMBA_CACHE_DIR" not in result.stderr
        assert list(Path(cache).rglob("*.nbi"))


FULL_DISK = """
import resource
resource.setrlimit(resource.RLIMIT_FSIZE, (2000, 2000))
"""


@pytest.mark.slow
def test_a_full_disk_is_no_error(tmp_path: Path) -> None:
    """A limit of the size of files stands in for the full disk."""
    pytest.importorskip("resource")
    variables = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path), "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-c", FULL_DISK + USE]
    result = subprocess.run(command, capture_output=True, text=True, env=variables)
    assert result.returncode == 0, result.stderr
    assert result.stderr.count("NUMBA_CACHE_DIR") == 1, result.stderr


def test_the_level_of_optimisation_of_others_is_not_changed() -> None:
    """Numba has one level for all; it is lower only while one of our kernels is compiled."""
    levels = []
    listener = type(
        "Listener", (event.Listener,), {"on_start": lambda *_: levels.append(int(config.OPT)), "on_end": id}
    )
    before = config.OPT
    with event.install_listener("numba:run_pass", listener()):
        assert njit(lambda x: x + 1)(1) == 2
    assert set(levels) == {min(1, before)}
    assert config.OPT is before
    with pytest.raises(numba.core.errors.NumbaError):
        njit(lambda x: undefined_name + x)(1)  # noqa: F821  the error of this test
    assert config.OPT is before


def test_other_errors_are_not_hidden(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(**_: object) -> None:
        raise RuntimeError("another reason")

    with pytest.raises(numba.core.errors.NumbaError):
        njit(cache=True)(lambda x: undefined_name + x)(1)  # noqa: F821  the error of this test
    monkeypatch.setattr(numba, "njit", refuse)
    with pytest.raises(RuntimeError, match="another reason"):
        njit(cache=True)(lambda x: x)


CALLEE = """
from irm.compilation import njit

@njit(cache=True)
def step(x):
    return x + {step}
"""
CALLER = """
from irm.compilation import njit
from kernels_of_a_test.callee import step

@njit(cache=True)
def twice(x):
    return step(step(x))
"""


def answer_of(folder: Path) -> str:
    """What the kernel of the package in `folder` computes in a new process."""
    code = "from kernels_of_a_test.caller import twice; print(twice(1))"
    path = os.pathsep.join([str(folder), str(ROOT)])
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, env={**os.environ, "PYTHONPATH": path}
    )
    assert not done.returncode, done.stderr
    return done.stdout.strip()


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """A package of two kernels, one of which calls the other."""
    folder = tmp_path / "kernels_of_a_test"
    folder.mkdir()
    (folder / "__init__.py").touch()
    (folder / "caller.py").write_text(CALLER)
    (folder / "callee.py").write_text(CALLEE.format(step=1))
    return folder


@pytest.mark.slow
def test_a_kept_kernel_is_compiled_again_only_if_one_that_it_calls_has_changed(package: Path) -> None:
    assert answer_of(package.parent) == "3"
    kept = {path: path.stat().st_mtime_ns for path in package.rglob("*.nbc")}
    (package / "plain.py").write_text("no_kernel = True")
    assert answer_of(package.parent) == "3"
    assert kept
    assert kept == {path: path.stat().st_mtime_ns for path in package.rglob("*.nbc")}
    (package / "callee.py").write_text(CALLEE.format(step=10))
    assert answer_of(package.parent) == "21"


@pytest.mark.parametrize("gone", [b"ca_module_renamed_since\nRaster\n.", b"cirm.free_space\nRenamedSince\n."])
def test_an_index_of_kept_kernels_that_names_types_that_are_gone_counts_as_empty(
    gone: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    index, path = classify_cells._cache._cache_file, tmp_path / "kernel.nbi"
    path.write_bytes(pickle.dumps(index._version) + gone)
    monkeypatch.setattr(index, "_index_path", str(path))
    assert index.load("any signature") is None
