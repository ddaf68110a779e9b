"""What the environment tests share."""

from __future__ import annotations

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
