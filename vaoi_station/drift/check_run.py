"""The check of a run from its evidence; the station and `vaoi recalibrate` share it."""

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
    """Estimate from a finished run where its cameras are.

    Args:
        run: id of the run.
        time: its time, as text.
        board_type: name or digest.
        setup: the setup of its stitching.
        times_s: (m,) time of every row.
        evidence: of its tasks, in any order.
        stitch: its result.
    """
    # Sorted, so that the result does not depend on the order in which workers finished.
    few = [subsample_links(e) for e in sorted(evidence, key=lambda e: e.task)]
    prepared = prepare_evidence(setup.cameras, setup.board_type, times_s, setup.conveyor_mm_s, few, stitch)
    return make_run_check(run, time, board_type, estimate_displacements(prepared))
