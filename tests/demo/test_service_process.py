"""Run the process of the demo's service with a configuration that it refuses."""

from __future__ import annotations

from pathlib import Path

import pytest

from vaoi_station.demo.service import Service
from vaoi_station.errors import DeviceError


def test_refused_configuration_is_the_last_log_line(tmp_path: Path) -> None:
    service = Service(tmp_path / "station.toml")
    with pytest.raises(DeviceError, match=r"did not start; .*station.toml: there is no such file"), service:
        pass
    assert not Path(f"/proc/{service.pid}").exists()
