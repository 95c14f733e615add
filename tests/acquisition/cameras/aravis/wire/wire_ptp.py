"""Cameras whose clocks follow a PTP master: by the names of their makers, and what happens when they do not."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.acquisition.cameras.aravis.stand_in import camera_config, station_config
from tests.acquisition.cameras.aravis.wire.stage import HEIGHT, WIDTH, Stage
from tests.gige.descriptions import FilmingLine
from tests.gige.referee import Referee
from vaoi_station.acquisition.cameras.aravis import connection
from vaoi_station.acquisition.process.messages import Health, Trouble
from vaoi_station.config import CameraConfig, StationConfig
from vaoi_station.errors import DeviceError
from vaoi_station.rig.gige.camera import Camera
from vaoi_station.rig.gige.ptp import OFFSET_NS, TAI_S

WITH_PTP = {
    "Basler-a2A2600-20gmBAS": ("PtpEnable", True, OFFSET_NS),  # state and offset after a latch
    "Basler-acA1300-60gm": ("GevIEEE1588", True, None),
    "Basler-acA2440-20gm": ("GevIEEE1588", True, OFFSET_NS),
    "FLIR-BFS-PGE-50S4C": ("GevIEEE1588", True, OFFSET_NS),
    "AVT_Manta_G507B": ("PtpMode", "Auto", None),
}
"""Description → its switch, the switch's value, and the offset that it states."""
TWO = ("Basler-acA2440-20gm", "AVT_Manta_G507B")


def configured(*cameras: Camera) -> list[CameraConfig]:
    return [
        camera_config(name=f"c{k}", address=camera.address, width=WIDTH, height=HEIGHT, ptp=True)
        for k, camera in enumerate(cameras)
    ]


def health(line: FilmingLine, wanted: Callable[[Health], bool]) -> Health:
    """Return the next of 40 heartbeats that is as wanted."""
    return next(report for report in (line.bench.until(Health) for _ in range(40)) if wanted(report))


def apart(report: Health) -> list[float]:
    """By how much the clock of each camera differs from the others, s."""
    return [seen.ptp.apart_s for seen in report.cameras if seen.ptp]


def test_it_is_switched_on_by_the_names_of_each_maker_and_awaited(
    plug: Callable[[str], Camera], tmp_path: Path, opened: Callable[[StationConfig], Stage]
) -> None:
    cameras = [plug(name) for name in WITH_PTP]
    stage = opened(station_config(tmp_path, configured(*cameras)))
    readings = [camera.read_clock() for camera in stage.cameras]
    for stand_in, camera, reading, (name, (switch, value, offset)) in zip(
        cameras, stage.cameras, readings, WITH_PTP.items(), strict=True
    ):
        referee = Referee(stand_in)
        assert referee.value(switch) == value, name
        state = next(s for s in ("PtpStatus", "GevIEEE1588Status") if referee.has(s))
        assert referee.value(state) == "Slave", name
        stated = camera.health().ptp
        assert stated is not None
        assert (stated.state, stated.offset_ns) == ("Slave", offset), name
        tai_s = stated.epoch_ns * 1e-9 + reading.device_s
        assert tai_s - TAI_S == pytest.approx(time.time() - time.monotonic() + reading.host_s, abs=0.1), name


def test_a_board_is_proven_with_the_clocks_of_a_master_and_what_they_do_wrong_is_said(
    plug: Callable[[str], Camera], tmp_path: Path
) -> None:
    """Clocks of GigE Vision 1 count in 8 ns without PTP, and in 1 ns with it."""
    cameras = [plug(name) for name in TWO]
    line = FilmingLine(tmp_path, cameras, configured(*cameras))
    try:
        assert line.proven(line.film(rows=3)) == 6
        assert line.bench.of(Trouble) == []
        assert apart(health(line, bool)) == [0.0, 0.0]

        def master_goes(row: int) -> None:
            if row == 1:
                cameras[0].clock_offset_ns += 37_000_000_000

        done = line.film(rows=4, after=master_goes)
        assert done.proof is not None
        assert {(f.camera, f.kind) for f in done.proof.findings} == {(0, "clock-jumped")}
        assert {trouble.code for trouble in line.bench.of(Trouble)} == {"clock-jumped"}
        ahead, behind = apart(health(line, lambda report: any(apart(report))))
        assert ahead == pytest.approx(37.0, abs=0.01)
        assert behind == pytest.approx(-37.0, abs=0.01)
        cameras[0].clock_offset_ns -= 37_000_000_000
        health(line, lambda report: not any(apart(report)))
        cameras[1].faults.clock_ppm = 20_000  # its master has gone: it holds over, and says Slave
        told = health(line, lambda report: apart(report)[1] > 0)
        assert apart(told)[0] < 0, "of two that differ neither is known to be right"
        assert [seen.ptp.state for seen in told.cameras if seen.ptp] == ["Slave", "Slave"]
    finally:
        line.close()


def test_without_a_master_it_films_with_its_own_clock_and_a_late_master_costs_nothing_before_arming(
    plug: Callable[[str], Camera], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(connection, "PTP_LIMIT_S", 0.5)
    camera = plug(TWO[0])
    camera.faults.ptp_ends_in = "Listening"
    line = FilmingLine(tmp_path, [camera], configured(camera))
    try:
        (seen,) = health(line, bool).cameras
        assert seen.ptp is not None
        assert (seen.connected, seen.ptp.state, seen.ptp.synchronised) == (True, "Listening", False)
        camera.faults.ptp_ends_in = "Slave"
        monkeypatch.undo()
        health(line, lambda report: bool(report.cameras[0].ptp and report.cameras[0].ptp.synchronised))
        for _ in range(3):  # the jump shows in the next reading of the clock, which a heartbeat does not wait for
            health(line, bool)
        assert line.proven(line.film(rows=3)) == 3
        assert line.bench.of(Trouble) == []
        camera.plug()  # its power was away: its clock begins at zero, and is set once more before it counts as back
        health(line, lambda report: not report.cameras[0].connected)
        back = health(line, lambda report: report.cameras[0].connected).cameras[0].ptp
        assert back is not None
        assert back.synchronised
        assert line.proven(line.film(rows=3)) == 3
        assert {trouble.code for trouble in line.bench.of(Trouble)} == {"camera-lost"}
    finally:
        line.close()


def test_a_camera_without_ptp_is_refused_by_name(plug: Callable[[str], Camera], tmp_path: Path) -> None:
    camera = plug("FLIR_BFLY_PGE_13H2M")
    with pytest.raises(DeviceError, match="camera c0: cannot follow a PTP master: it has none of PtpEnable") as caught:
        FilmingLine(tmp_path, [camera], configured(camera))
    assert caught.value.code == "feature-absent"
