from __future__ import annotations

import json
import os
from datetime import UTC, datetime, timedelta
from pathlib import Path

from tests.runs.conftest import a_config
from vaoi_station.config import StationConfig
from vaoi_station.runs.merging.flat_field_warnings import flat_field_warnings


def with_fields(
    config: StationConfig,
    directory: Path,
    days: float,
    width: int | None = None,
    lights: tuple[str | None, ...] = (None,),
) -> StationConfig:
    heads = [camera.head for camera in config.cameras]
    document = {
        "format": "vaoi-flatfield",
        "version": 1,
        "created": (datetime.now(UTC) - timedelta(days=days)).isoformat(),
        "cameras": [{"width": width or h.width, "height": h.height, "read": 1.0, "shot": 0.03} for h in heads],
        "fields": [
            {"camera": i, "light": light, "file": f"fields/{i}-{light}.tiff", "level": 0.5, "rows": 4}
            for i in range(len(heads))
            for light in lights
        ],
    }
    path = directory / "flatfield.json"
    # Another time stamp each time: a document is read again only if it has changed.
    before_ns = path.stat().st_mtime_ns if path.exists() else 0
    path.write_text(json.dumps(document))
    os.utime(path, ns=(before_ns + 10**9, before_ns + 10**9))
    return config.model_copy(update={"flat_fields": directory})


def test_expired_flat_fields_are_warned_of(tmp_path: Path) -> None:
    (reason,) = flat_field_warnings(with_fields(a_config(tmp_path), tmp_path, days=200))
    assert reason.code == "flat-fields-expired"
    assert "are 200 days old and expire after 180" in reason.message
    assert "vaoi flatfield" in reason.action


def test_absent_flat_fields_and_those_of_another_array_are_warned_of(tmp_path: Path) -> None:
    config = with_fields(a_config(tmp_path), tmp_path, days=1, width=100)
    (reason,) = flat_field_warnings(config)
    assert reason.code == "flat-fields-unfit"
    assert "has 100×" in reason.message
    (tmp_path / "flatfield.json").unlink()
    (reason,) = flat_field_warnings(config)
    assert reason.code == "flat-fields-unfit"
    assert "there is no such file" in reason.message
