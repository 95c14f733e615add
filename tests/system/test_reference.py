"""A whole station with a reference: a run is taught, and later boards are placed against it as by `vaoi stitch`."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from tests.system.conftest import config_of, film_one, until_state
from vaoi_station.config import MethodName, ReplayConfig, StationConfig
from vaoi_station.errors import StateError
from vaoi_station.files import open_recording, read_calibration, write_calibration
from vaoi_station.geometry import apply
from vaoi_station.model import Status, Stitch
from vaoi_station.runs.control.coordinator import StationCoordinator
from vaoi_station.runs.states.schemas import RunDetail
from vaoi_station.simulation import Twin
from vaoi_station.station import Station
from vaoi_station.stitching.recordings.opening import open_run
from vaoi_station.stitching.work import stitch_frames


def used(stitch: Stitch) -> dict[str, int]:
    return {kind: count["used"] for kind, count in stitch.quality["links"].items() if count["used"]}


def apart_px(a: Stitch, b: Stitch, twin: Twin) -> float:
    """Return the largest difference between two results at the corners of the frames in CAD, px."""
    w, h = twin.scenario.array.width_px - 1.0, twin.scenario.array.height_px - 1.0
    corners = np.array([[0, 0], [w, 0], [w, h], [0, h]])
    assert a.cad_matrix is not None
    assert b.cad_matrix is not None
    worst = 0.0
    for rows_a, rows_b in zip(a.image_matrices, b.image_matrices, strict=True):
        for m_a, m_b in zip(rows_a, rows_b, strict=True):
            assert m_a is not None
            assert m_b is not None
            b_from_a = m_b @ b.cad_matrix @ np.linalg.inv(m_a @ a.cad_matrix)
            worst = max(worst, float(np.abs(apply(b_from_a, corners) - corners).max()))
    return worst


def offline(reference: Path, recording: Path, method: MethodName) -> Stitch:
    """Return the result of `vaoi stitch RECORDING --reference DIR --method METHOD`."""
    opened = open_run(recording, reference=reference, method=method)
    assert opened.reference is not None
    return stitch_frames(opened.setup, opened.recording.head, opened.recording.frame, opened.reference.recording.frame)


def shows(path: Path, station: StationCoordinator, run: RunDetail) -> bool:
    """Return whether a run shows this recording: boards that pass before the station is armed are skipped."""
    frame = open_recording(path).frame(0, run.rows // 2)
    return frame is not None and np.array_equal(frame, station.frame(run.id, 0, run.rows // 2)[0])


@pytest.fixture
def config(replay_config: Callable[..., StationConfig]) -> StationConfig:
    """Return the configuration of a station with one worker that replays two boards in turn."""
    return replay_config(pace="fast", pause_s=0.01).model_copy(update={"workers": 1})


@pytest.fixture(scope="module")
def shared_config(twin: Twin, recordings: tuple[Path, Path], tmp_path_factory: pytest.TempPathFactory) -> StationConfig:
    replay = ReplayConfig(recordings=recordings, pace="fast", pause_s=0.01)
    return config_of(twin, tmp_path_factory.mktemp("shared"), "replay", replay=replay, workers=1)


@pytest.fixture(scope="module")
def shared_station(shared_config: StationConfig) -> Iterator[StationCoordinator]:
    with Station(shared_config) as started:
        until_state(started.coordinator, "idle")
        yield started.coordinator


@pytest.fixture
def station(shared_station: StationCoordinator) -> Iterator[StationCoordinator]:
    """The shared station, without a reference before and after each test."""
    yield shared_station
    shared_station.forget_reference("small")
    shared_station.set_method("small", None)


@pytest.mark.parametrize("method", ["auto", "reference"])
def test_later_boards_are_placed_against_a_reference_as_offline(
    station: StationCoordinator, shared_config: StationConfig, recordings: tuple[Path, Path], twin: Twin,
    method: MethodName,
) -> None:  # fmt: skip
    first = film_one(station)
    assert station.teach_reference("small", first.id)
    status = station.reference("small")
    assert (status.run, status.usable, status.fault) == (first.id, True, None)
    assert (status.cameras, status.rows, status.calibration) == (first.cameras, first.rows, first.calibration)
    assert 0 < status.frames <= first.counts.ok
    station.set_method("small", method)
    second = film_one(station)
    stitch = station.stitch(second.id)
    assert (stitch.method, stitch.quality["reference"]) == (method, first.id)
    assert stitch.status is Status.OK, stitch.reasons
    assert used(stitch)["reference"] > 100
    assert method == "auto" or set(used(stitch)) == {"reference"}
    assert "reference" in {task.kind for task in station.timeline(second.id).tasks}
    played = next(path for path in recordings if shows(path, station, second))
    expected = offline(shared_config.data / "references" / first.id, played, method)
    assert used(expected) == used(stitch)
    assert apart_px(stitch, expected, twin) <= 1e-6


def test_a_reference_survives_a_restart_but_not_another_calibration(
    config: StationConfig, wait_state: Callable[[StationCoordinator, str], None]
) -> None:
    with Station(config) as life:
        wait_state(life.coordinator, "idle")
        first = film_one(life.coordinator)
        life.coordinator.teach_reference("small", first.id)
    with Station(config) as life:
        wait_state(life.coordinator, "idle")
        assert life.coordinator.reference("small").usable
        again = film_one(life.coordinator)
        assert life.coordinator.stitch(again.id).quality["reference"] == first.id
    calibration = read_calibration(config.calibration)
    moved = [np.array([[1, 0, 0.4], [0, 1, 0], [0, 0, 1]]) @ m for m in calibration.camera_matrices]
    write_calibration(config.calibration, calibration.model_copy(update={"camera_matrices": tuple(moved)}))
    with Station(config) as life:
        station = life.coordinator
        wait_state(station, "idle")
        status = station.reference("small")
        assert not status.usable
        assert status.fault is not None
        assert "another calibration: camera 0 differs by 0.40 px" in status.fault.message
        seen = station.snapshot().last_event
        later = film_one(station)
        (reason,) = [r for r in later.reasons if r.code == "reference-unusable"]
        assert reason.action == "Teach the reference again with the present calibration."
        assert "reference-unusable" in {record.code for record in station.events(seen)}
        stitch = station.stitch(later.id)
        assert "reference" not in stitch.quality
        assert "reference" not in used(stitch)
        station.set_method("small", "reference")
        with pytest.raises(StateError, match="another calibration") as refused:
            station.arm("small")
        assert refused.value.code == "reference-unusable"
        assert station.snapshot().state == "idle"
