from __future__ import annotations

import pytest
from pydantic import ValidationError

from vaoi_station.model import FrameRecord, Pulse, Verdict


@pytest.mark.parametrize("verdict", list(Verdict))
def test_records_survive_json(verdict: Verdict) -> None:
    record = FrameRecord(camera=1, row=2, verdict=verdict, cause="no packet received", slot=7, exposure_us=250.0)
    assert FrameRecord.model_validate_json(record.model_dump_json()) == record


def test_a_missing_frame_has_no_slot_and_no_times() -> None:
    record = FrameRecord(camera=1, row=2, verdict=Verdict.MISSING)
    assert (record.slot, record.frame_id, record.camera_time_s, record.pulse_error_us) == (None, None, None, None)


def test_pulses_survive_json_and_refuse_unknown_keys() -> None:
    pulse = Pulse(index=3, time_s=0.375, light="dark field")
    assert Pulse.model_validate_json(pulse.model_dump_json()) == pulse
    with pytest.raises(ValidationError, match="unknown key"):
        Pulse.model_validate({"index": 3, "time_s": 0.375, "colour": "red"})
