"""The drift check of a run, made from the findings of its conclusion, for the station and for `vaoi recalibrate`."""

from __future__ import annotations

from vaoi_station.drift.checks import LampCheck, RunCheck, make_run_check
from vaoi_station.drift.estimate import estimate_displacements
from vaoi_station.stitching.quality.findings import Findings


def check_run(run: str, time: str, board_type: str, findings: Findings, lamps: tuple[LampCheck, ...] = ()) -> RunCheck:
    """Return the displacements of all cameras as a finished run shows them.

    Args:
        run: id of the run.
        time: time of the run, as text.
        board_type: name or digest of the board type.
        findings: findings from which the result of the run was derived.
        lamps: brightness of the board (`lamps.measure_lamps`), if it was measured.
    """
    return make_run_check(run, time, board_type, estimate_displacements(findings), lamps)
