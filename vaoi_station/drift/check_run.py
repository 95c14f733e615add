"""Computation of a run's drift check from the evidence of the run, for the station and for `vaoi recalibrate`."""

from __future__ import annotations

from collections.abc import Sequence

from vaoi_station.drift.checks import RunCheck, make_run_check
from vaoi_station.drift.equations import estimate_displacements
from vaoi_station.drift.evidence import prepare_evidence, subsample_links
from vaoi_station.geometry.transforms import Floats
from vaoi_station.model import Stitch
from vaoi_station.stitching.matching.evidence import Evidence
from vaoi_station.stitching.work import StitchSetup


def check_run(
    run: str,
    time: str,
    board_type: str,
    setup: StitchSetup,
    times_s: Floats,
    evidence: Sequence[Evidence],
    stitch: Stitch,
) -> RunCheck:
    """Estimate the displacements of all cameras from a finished run, for its drift check.

    Args:
        run: id of the run.
        time: time of the run, as text.
        board_type: name or digest of the board type.
        setup: the inputs with which the run was stitched.
        times_s: (m,) time of each of the m rows.
        evidence: evidence of the run's tasks, in any order.
        stitch: result of the run.
    """
    # The evidence is sorted, so that the result does not depend on the order in which workers finished.
    few = [subsample_links(e) for e in sorted(evidence, key=lambda e: e.task)]
    prepared = prepare_evidence(setup.cameras, setup.board_type, times_s, setup.conveyor_mm_s, few, stitch)
    return make_run_check(run, time, board_type, estimate_displacements(prepared))
