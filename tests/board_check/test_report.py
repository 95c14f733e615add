"""The document of a check."""

from __future__ import annotations

from vaoi_station.board_check.report import BoardCheck, CheckWarning


def test_a_report_without_a_correction_is_short() -> None:
    warning = CheckWarning(code="not-found", message="nothing is found.")
    report = BoardCheck(board_type="b", score=4.2, rival_score=4.1, components=9, measured=0, warnings=[warning])
    document = report.model_dump(mode="json", exclude_none=True)
    assert document["format"] == "vaoi-board-check"
    assert not {"proposal", "residual", "tester_from_cad"} & document.keys()
    assert BoardCheck.model_validate(document) == report
