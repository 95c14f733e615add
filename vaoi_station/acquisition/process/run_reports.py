"""Build the reports of finished runs and of device faults."""

from __future__ import annotations

import logging

from pydantic import ValidationError

from vaoi_station.acquisition.clocks import ClockJump
from vaoi_station.acquisition.pairing.proof import doubts_of
from vaoi_station.acquisition.pairing.recorder import Finished
from vaoi_station.acquisition.pairing.run_record import RunRecord
from vaoi_station.acquisition.process.messages import RunFinished, Trouble
from vaoi_station.config import StationConfig
from vaoi_station.errors import DeviceError, VaoiError
from vaoi_station.model import RecordingHead
from vaoi_station.model.recording import linear_gain

_log = logging.getLogger(__name__)


def finished_report(config: StationConfig, finished: Finished, now_s: float) -> RunFinished:
    """Return the report of a finished run, with the head of its recording, in which unusable frames are missing."""
    record = finished.record
    assert record.run is not None
    assert record.bay is not None
    try:
        head = _head(config, finished)
    except ValidationError as error:
        # What a device reported contradicts itself. This costs the certainty of one run, not the process.
        _log.exception("run %s: its recording cannot be described", record.run)
        head = _head_without_measurements(config, finished, _refused(finished, error))
    # A fast replay reports pulses before their time, so the last pulse may lie in the future.
    last_pulse_s = min(max(p.host_s for p in record.pulses.values()), now_s)
    return RunFinished(
        run=record.run,
        bay=record.bay,
        head=head,
        frames=finished.frames,
        last_frame_host_s=record.last_frame_host_s or last_pulse_s,
        reason=record.reason,
        unassigned=record.unassigned,
        proof=finished.proof,
        interruptions=record.interruptions_s(),
    )


def _head(config: StationConfig, finished: Finished) -> RecordingHead:
    record = finished.record
    measured = {
        "trigger_times_s": record.times_s(),
        "belt_mm": record.belt_mm(),
        "exposures_us": record.exposures_us(),
        "gains": _gains(config, record),
        "lights": record.lights(),
    }
    # The whole head is validated: `model_copy` would take the measured values as they are.
    known = _head_without_measurements(config, finished, doubts_of(finished.proof))
    return RecordingHead.model_validate(dict(known) | measured)


def _head_without_measurements(config: StationConfig, finished: Finished, doubts: tuple[str, ...]) -> RecordingHead:
    record = finished.record
    return RecordingHead(
        format="vaoi-recording",
        version=1,
        cameras=config.heads,
        rows=record.rows,
        trigger_period_s=record.period_s,
        conveyor_mm_s=record.conveyor_mm_s or config.line.conveyor_mm_s,
        rotation_deg=config.line.expected_board.rotation_deg or None,
        missing=tuple((f.camera, f.row) for f in finished.frames if not f.usable),
        doubts=doubts,
    )


def _refused(finished: Finished, error: ValidationError) -> tuple[str, ...]:
    first = error.errors()[0]
    what = ": ".join([*map(str, first["loc"]), first["msg"]])
    refused = f"times, exposures and lights of this run contradict each other and are not used ({what})"
    return refused, *doubts_of(finished.proof)


def _gains(config: StationConfig, record: RunRecord) -> tuple[tuple[float, ...], ...] | None:
    """Return the linear gains of every row; None if all are 1, which is what a recording without the key means."""
    of_station = tuple(linear_gain(camera.gain_db) for camera in config.cameras)
    gains = record.gains() or (of_station,) * record.rows
    return gains if any(gain != 1 for row in gains for gain in row) else None


def clock_jump_error(camera: str, jump: ClockJump) -> DeviceError:
    """Return the error that reports a jump of a camera's clock."""
    return DeviceError(
        f"{camera}: {jump}; frames of the {jump.until_s - jump.since_s:.1f} s before it was noticed are not used.",
        action="Find what sets the camera's clock (a PTP master that came or went, another program); check its power.",
        code="clock-jumped",
    )


def trouble_report(error: VaoiError, device: str = "") -> Trouble:
    """Return the report of an error, with an action. The message begins with the name of the device."""
    named = not device or error.message.startswith(f"{device}:")
    message = error.message if named else f"{device}: {error.message}"
    return Trouble(error.code, message, error.action or "Read the station's log, then arm again.")
