"""The stand-in for Aravis in every module that uses the library."""

from __future__ import annotations

import pytest

from tests.acquisition.cameras.aravis.stand_in import LIBRARY, StandInError
from vaoi_station.acquisition.cameras.aravis import (
    connection,
    features,
    links,
    network,
    sequencer,
    settings,
    stream,
)


@pytest.fixture
def _stand_in(monkeypatch: pytest.MonkeyPatch) -> None:
    """Replace the library; the tests of this folder then run where it is not installed."""
    for module in (connection, features, links, network, sequencer, settings, stream):
        monkeypatch.setattr(module, "aravis", lambda: LIBRARY, raising=False)
        monkeypatch.setattr(module, "glib_error", lambda: StandInError, raising=False)
    monkeypatch.setattr(stream, "received_bytes", lambda buffer: buffer.frame.received)
