"""What identifies the terms of a call."""

from __future__ import annotations

from vaoi_station.plant.restitch.terms import Terms


def test_documents_are_identified_by_their_content() -> None:
    plain = Terms("vaoi_station 1").document()
    assert plain == {"software": "vaoi_station 1", "method": None, "calibration": None, "board_type": None}
    changed = Terms("vaoi_station 1", calibration=b"{}", method="features").document()
    assert changed["method"] == "features"
    assert len(changed["calibration"]) == 64
