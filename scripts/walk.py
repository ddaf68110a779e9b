"""Walk through the documentation as a newcomer does: a fresh clone, an empty home directory, what the pages say.

    python scripts/walk.py student        # robot learning; researcher: planning; engineer: base placement; rl

Every command and every Python block of the pages is run in its order and nothing else, but for lines with files of the
reader's own (`my_…`). Printed are what was typed, and the CPU and wall time of each block. A command that fails ends
the walk. pip's cache is that of the machine.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
TUTORIALS = ROOT / "docs/tutorials"
WALKS = {
    "student": ("quickstart", "learning"),
    "researcher": ("quickstart", "planning"),
    "engineer": ("base_placement",),
    "rl": ("reinforcement_learning",),
}
"""Pages of docs/tutorials; before them comes the first block of the quickstart, which installs."""
_BLOCK = re.compile(r"^```(sh|python)\n(.*?)^```$", re.DOTALL | re.MULTILINE)
_ACTIVATE = ". .venv/bin/activate"
_ALREADY_DONE = ("git clone ", "cd ")
"""How lines begin that this script does itself: the clone is made of the repository at hand."""
_PYTHON = """
import json, os, sys
names = {"__name__": "__main__"}
for line in sys.stdin:
    exec(compile(json.loads(line), "page", "exec"), names)
    print("\\n\\0", sum(os.times()[:4]), flush=True)
"""
"""A Python that runs blocks, all with the same names, and says how much CPU time [s] it has used."""


def blocks(walk: str) -> Iterator[tuple[str, str, str]]:
    """Page, language and code of the blocks of a walk; of the quickstart's installation only the first one."""
    text = (TUTORIALS / "quickstart.md").read_text(encoding="utf-8")
    installation, rest = re.split(r"^## One environment$", text, maxsplit=1, flags=re.MULTILINE)
    yield "quickstart", *_BLOCK.findall(installation)[0]
    for page in WALKS[walk]:
        text = rest if page == "quickstart" else (TUTORIALS / f"{page}.md").read_text(encoding="utf-8")
        yield from ((page, *block) for block in _BLOCK.findall(text))


class Newcomer:
    """A shell and one Python for each page, in a clone.

    Attributes:
        cpu_s: CPU time [s] of all that was run.
    """

    def __init__(self, clone: Path, home: Path) -> None:
        kept = {name: value for name, value in os.environ.items() if name.startswith(("PIP_", "SSL_", "LANG"))}
        path = os.pathsep.join((str(Path(sys.executable).resolve().parent), "/usr/local/bin", "/usr/bin", "/bin"))
        cache = subprocess.check_output([sys.executable, "-m", "pip", "cache", "dir"], text=True).strip()
        self._environment = {"PIP_CACHE_DIR": cache, **kept, "HOME": str(home), "PATH": path}
        self._clone, self._page, self.cpu_s = clone, "", 0.0
        self._python: subprocess.Popen[str] | None = None

    def run(self, page: str, language: str, code: str) -> None:
        """Run a block, print it and its times."""
        if language == "sh":
            lines = [line for line in code.splitlines() if "my_" not in line and not line.startswith(_ALREADY_DONE)]
            code = "\n".join(lines)
        if not code.strip():
            return
        print(f"[{page}] {language}\n{code.rstrip()}", flush=True)
        started, before = time.monotonic(), self.cpu_s
        (self._run_shell if language == "sh" else self._run_python)(page, code)
        print(f"  -> {self.cpu_s - before:.1f} CPU s, {time.monotonic() - started:.0f} s\n", flush=True)

    def _run_shell(self, _: str, code: str) -> None:
        before = sum(resource.getrusage(resource.RUSAGE_CHILDREN)[:2])
        subprocess.run(["bash", "-euc", code], cwd=self._clone, env=self._environment, check=True)
        self.cpu_s += sum(resource.getrusage(resource.RUSAGE_CHILDREN)[:2]) - before
        if _ACTIVATE in code:
            bin_ = self._clone / ".venv/bin"
            self._environment |= {"VIRTUAL_ENV": str(bin_.parent), "PATH": f"{bin_}:{self._environment['PATH']}"}

    def _run_python(self, page: str, code: str) -> None:
        if self._python is None or page != self._page:
            self.close()
            command = ["bash", "-c", 'exec python -c "$0"', _PYTHON]
            where: dict[str, Any] = {"cwd": self._clone, "env": self._environment}
            self._python = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, **where)
            self._page, self._used = page, 0.0
        assert self._python.stdin is not None
        assert self._python.stdout is not None
        print(json.dumps(code), file=self._python.stdin, flush=True)
        for line in self._python.stdout:
            if line.startswith("\0"):
                used = float(line[1:])
                self.cpu_s, self._used = self.cpu_s + used - self._used, used
                return
            print(line, end="")
        raise SystemExit(f"the Python of {page} has failed")

    def close(self) -> None:
        """End the Python."""
        if self._python is not None:
            self._python.communicate()


def main() -> None:
    """Walk, and print the sum; nothing but Python itself is needed."""
    parser = argparse.ArgumentParser(description="Walk through the documentation as a newcomer does.")
    parser.add_argument("walk", choices=WALKS)
    walk = parser.parse_args().walk
    with tempfile.TemporaryDirectory() as folder:
        clone, home = Path(folder) / "clutter-env", Path(folder) / "home"
        home.mkdir()
        subprocess.run(["git", "clone", "--quiet", str(ROOT), str(clone)], check=True)
        newcomer, started = Newcomer(clone, home), time.monotonic()
        try:
            for page, language, code in blocks(walk):
                newcomer.run(page, language, code)
        finally:
            newcomer.close()
    print(
        f"{walk}: {newcomer.cpu_s / 60:.1f} minutes of CPU time, {(time.monotonic() - started) / 60:.1f} of wall time"
    )


if __name__ == "__main__":
    main()
