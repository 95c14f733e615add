"""A run's check from its evidence: the same for the live station and for recordings."""

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
    """What a finished run tells of its cameras.

    Args:
        run: its id.
        time: when it was, as text.
        board_type: name or digest.
        setup: what it was stitched with.
        times_s: (m,) time of every row.
        evidence: of its tasks, in any order.
        stitch: its result.
    """
    few = [subsample_links(e) for e in sorted(evidence, key=lambda e: e.task)]
    laid_out = prepare_evidence(setup.cameras, setup.board_type, times_s, setup.conveyor_mm_s, few, stitch)
    return make_run_check(run, time, board_type, estimate_displacements(laid_out))
