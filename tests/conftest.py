"""What the environment tests share."""

from __future__ import annotations

from pathlib import Path

import pytest

from clutter_env.errors import RenderingUnavailable
from clutter_env.rendering.renderer import make_context


@pytest.fixture(scope="session")
def needs_gl() -> None:
    """Skips the test on a machine without any OpenGL."""
    try:
        make_context(16, 16).free()
    except RenderingUnavailable as missing:
        pytest.skip(str(missing))


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Give each worker whole files, so that what a file shares is made once; those of irm share maps."""
    for item in items:
        folder = item.path.relative_to(Path(__file__).parent)
        item.add_marker(pytest.mark.xdist_group("irm" if folder.parts[0] == "irm" else str(folder)))
