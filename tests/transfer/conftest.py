"""A station with files, history, a reference and a kept recording, as a service leaves it on disk."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from tests.runs.conftest import _silent_peer, a_calibration, a_stitch, make_rig, store
from tests.runs.control.test_teaching import filmed
from vaoi_station.demo.station_files import to_toml
from vaoi_station.files import write_calibration
from vaoi_station.model import BoardCode, Status
from vaoi_station.model.board_identity import IdentityDocument

__all__ = ["_silent_peer", "make_rig", "store"]


@dataclass(frozen=True)
class Site:
    """A station on disk, and its runs: one ok, one degraded with a recording."""

    config: Path
    sound: str
    degraded: str
    rig: Any


MEASURES = (
    '{"format":"vaoi-parts","version":1,"board_type":"small","good_boards":["r"],"remarks":[],"remark_codes":[],"remark_values":[],'
    '"parts":{"R1":{"presence":0.9,"frames":4,"boards":1,"reasons":[],"marked":[]}},"reason_texts":{}}'
)


@pytest.fixture
def site(make_rig: Callable[..., Any], tmp_path: Path) -> Site:
    rig = make_rig()
    rig.ready()
    rig.store.configurations.begin('{"name": "test"}', "2026")
    sound = filmed(rig)
    rig.store.save_heights(sound, '{"heights":{}}').result(10)
    rig.store.save_parts(sound, MEASURES).result(10)
    code = BoardCode(
        text="SN-1", symbology="qr", board_id="SN-1", center=(0, 0), corners=((0, 0), (1, 0), (1, 1), (0, 1)),
        module_mm=0.2, error_correction_used=0,
    )  # fmt: skip
    identity = IdentityDocument(state="not-compared", board_id="SN-1", codes=(code,))
    rig.archive.identify(sound, identity).result(10)
    rig.coordinator.teach_reference("small", sound)
    rig.workers.result = lambda head: a_stitch(head, Status.DEGRADED)
    degraded = filmed(rig)
    rig.wait_for(lambda: rig.coordinator.kept.recordings.runs == 1, "the recording")
    write_calibration(tmp_path / "calibration.json", a_calibration())
    (rig.config.data / "keys.json").write_text("{}")
    path = tmp_path / "station.toml"
    ring = rig.config.ring.model_copy(update={"keep_s": 1.0})
    paths = {"calibration": Path("calibration.json"), "board_types": Path("board-types"), "data": Path("data")}
    path.write_text(to_toml(rig.config.model_copy(update={**paths, "ring": ring})))
    return Site(path, sound, degraded, rig)
