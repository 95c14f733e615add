"""Documents of references: a status repeats its record, and survives JSON."""

from __future__ import annotations

from vaoi_station.runs.states.schemas import Reason
from vaoi_station.runs.states.stitching_schemas import ReferenceRecord, ReferenceStatus, StitchingMethod

RECORD = ReferenceRecord(
    run="r1", taught="2026-01-01T00:00:00.000Z", calibration="c0ffee", cameras=2, rows=3, frames=6, size_bytes=10,
    cad_sigma_px=None,
)  # fmt: skip


def test_a_status_has_all_fields_of_its_record() -> None:
    fault = Reason(code="other-calibration", message="The calibration is another.")
    status = ReferenceStatus(**RECORD.model_dump(), board_type="b", usable=False, fault=fault)
    assert ReferenceStatus.model_validate_json(status.model_dump_json()) == status
    assert RECORD.model_dump().items() <= status.model_dump().items()


def test_a_method_states_where_it_comes_from() -> None:
    assert StitchingMethod(method="auto", chosen="station").model_dump() == {"method": "auto", "chosen": "station"}
