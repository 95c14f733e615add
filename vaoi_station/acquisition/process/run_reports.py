"""What the station is told of a finished run, built from its sheet."""

from __future__ import annotations

from vaoi_station.acquisition.pairing.recorder import Finished
from vaoi_station.acquisition.process.messages import RunFinished, Trouble
from vaoi_station.config import StationConfig
from vaoi_station.errors import VaoiError
from vaoi_station.model import RecordingHead, Verdict


def run_finished(config: StationConfig, finished: Finished, now_s: float) -> RunFinished:
    """The report; `head` is that of a recording of this run, where frames that are not whole count as missing."""
    sheet = finished.sheet
    assert sheet.run is not None
    assert sheet.bay is not None
    head = RecordingHead(
        format="vaoi-recording",
        version=1,
        cameras=tuple(c.head for c in config.cameras),
        rows=sheet.rows,
        trigger_period_s=sheet.period_s,
        conveyor_mm_s=config.line.conveyor_mm_s,
        missing=tuple((f.camera, f.row) for f in finished.frames if f.verdict is not Verdict.OK),
        trigger_times_s=sheet.times_s(),
        exposures_us=sheet.exposures_us(),
        lights=sheet.lights(),
    )
    last_pulse_s = min(max(p.host_s for p in sheet.pulses.values()), now_s)
    return RunFinished(
        run=sheet.run,
        bay=sheet.bay,
        head=head,
        frames=finished.frames,
        last_frame_host_s=sheet.last_frame_host_s or last_pulse_s,
        reason=sheet.reason,
        unassigned=sheet.strays,
        proof=finished.proof,
    )


def trouble(error: VaoiError, what: str = "") -> Trouble:
    """An error as a report; the operator always gets a sentence to act on."""
    named = not what or error.message.startswith(f"{what}:")
    message = error.message if named else f"{what}: {error.message}"
    return Trouble(error.code, message, error.action or "Look at the station's log, then arm again.")
