"""Pictures of known blur, as those of the live view."""

from __future__ import annotations

import pytest

from tests.viewing.conftest import Painter


@pytest.fixture(scope="session")
def painter() -> Painter:
    return Painter()
