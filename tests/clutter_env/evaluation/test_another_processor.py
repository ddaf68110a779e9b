"""What `verify` says of a file on another machine, emulated: other arithmetic in the C library, other kernels, a core.

On another processor it is confirmed by the same digits, or not comparable, and the answer says what is other. It is
never plainly refused.
"""

from __future__ import annotations

import os
import platform
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

from clutter_env.evaluation.evaluate import evaluate
from clutter_env.evaluation.scenes import SceneSet
from clutter_env.evaluation.tables import results
from clutter_env.reporting.files import write_json

CPU = Path("/proc/cpuinfo")
HAS_FMA = platform.libc_ver()[0] == "glibc" and CPU.exists() and " fma " in CPU.read_text()
WITHOUT_FMA = {"GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA,-AVX512F,-AVX"}
OTHER_KERNELS = {"OPENBLAS_CORETYPE": "Prescott", "NPY_DISABLE_CPU_FEATURES": "X86_V3 X86_V4 AVX512_ICL"}
ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}
ONE_CORE = ("taskset", "-c", "0")


@pytest.fixture(scope="module")
def pushed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two episodes that push objects, whose every contact depends on the last bits of the actions before."""
    file = tmp_path_factory.mktemp("results") / "pushed.json"
    write_json(file, results(evaluate("direct-approach", SceneSet("side-15-v3", count=2))))
    return file


def verified(file: Path, changed: dict[str, str], before: Sequence[str] = ()) -> tuple[int, str]:
    """Exit code and output of the command in another environment."""
    program = "from clutter_env.cli.main import main\nif __name__ == '__main__':\n    main()"
    script = file.parent / "command.py"
    script.write_text(program)
    command = [*before, sys.executable, str(script), "verify", str(file), "--workers", "1"]
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).resolve().parents[3]), **changed}
    ended = subprocess.run(command, env=environment, capture_output=True, text=True)
    return ended.returncode, ended.stdout + ended.stderr


@pytest.mark.slow
@pytest.mark.skipif(not HAS_FMA, reason="no C library with FMA")
def test_other_arithmetic_is_named_and_no_file_is_plainly_refused_for_it(pushed: Path) -> None:
    code, said = verified(pushed, WITHOUT_FMA)
    assert "It was recorded with arithmetic" in said
    if code == 0:
        assert "with the same digits, although the file was made with something else" in said
    else:
        assert "not comparable: the differences may come from what the file was made with" in said


@pytest.mark.slow
@pytest.mark.skipif(platform.machine() != "x86_64", reason="the names of kernels are those of x86-64")
@pytest.mark.skipif(shutil.which("taskset") is None, reason="no taskset")
def test_one_core_and_other_kernels_of_matrices_give_the_same_digits(pushed: Path) -> None:
    code, said = verified(pushed, OTHER_KERNELS | ONE_THREAD, ONE_CORE)
    assert code == 0, said
    assert "confirmed: 0 clean successes in 2 episodes" in said
    assert "although" not in said
