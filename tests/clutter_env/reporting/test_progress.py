"""Progress of long work in a terminal and in a log file."""

from __future__ import annotations

import logging
import time

import pytest

from clutter_env.reporting.progress import progress_bar, shown_compilation


def test_a_log_file_gets_few_whole_lines(capsys: pytest.CaptureFixture[str]) -> None:
    for _ in progress_bar(range(1000), desc="scenes"):
        time.sleep(1e-4)
    text = capsys.readouterr().err
    assert "\r" not in text
    first, last = text.splitlines()
    assert first.startswith("scenes:   0%")
    assert last.startswith("scenes: 100%")


def test_what_takes_longer_than_ten_seconds_says_so_before_it_starts(capsys: pytest.CaptureFixture[str]) -> None:
    for seconds, said in ((9.0, ""), (42.0, "about 42 s"), (600.0, "about 10 min")):
        with progress_bar(total=1, seconds=seconds):
            pass
        first = capsys.readouterr().err.partition("\n")[0]
        assert said in first
        assert ("about" in first) == bool(said)


def test_every_so_often_there_is_a_line(capsys: pytest.CaptureFixture[str]) -> None:
    with progress_bar(total=10, mininterval=0.01) as bar:
        for _ in range(10):
            time.sleep(0.02)
            bar.update()
        bar.close()  # and once more at the end of the block
    assert len(capsys.readouterr().err.splitlines()) > 5


def test_a_bar_that_ctrl_c_kept_from_beginning_is_closed_without_a_word(capsys: pytest.CaptureFixture[str]) -> None:
    with progress_bar(total=1) as bar:
        pass
    capsys.readouterr()
    type(bar).__new__(type(bar)).close()
    assert not capsys.readouterr().err


def test_compilation_is_shown_by_the_name_of_the_kernel(capsys: pytest.CaptureFixture[str]) -> None:
    logger = logging.getLogger("planners.warming")
    with shown_compilation():
        pass
    assert not capsys.readouterr().err, "nothing is compiled"
    with shown_compilation():
        logger.warning("compiling the planner's kernels")
        logger.info("compiling a.b.first")
        logger.info("compiling a.b.second")
    text = capsys.readouterr().err
    assert "compiling the planner's kernels" in text
    assert text.splitlines()[-1].startswith("compiling a.b.second (2 kernels")
    assert logger.propagate
    assert not logger.handlers
