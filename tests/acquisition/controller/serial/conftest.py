"""A controller in Python at a terminal."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.acquisition.controller.serial.fake_firmware import FakeFirmware, fake_firmware


@pytest.fixture
def device() -> Iterator[tuple[str, FakeFirmware]]:
    """The name of a terminal, and the controller behind it."""
    with fake_firmware() as device:
        yield device
