"""Tests of the doubts that a proof leaves."""

from __future__ import annotations

from typing import get_args

import pytest

from vaoi_station.acquisition.pairing.proof import (
    ACTIONS,
    QUESTIONING_KINDS,
    Kind,
    TriggerFinding,
    TriggerProof,
    doubtful,
    doubts_of,
)


def proof_of(*findings: tuple[int, int | None, Kind]) -> TriggerProof:
    found = tuple(TriggerFinding(camera=c, row=r, kind=k, text=f"text of {k}") for c, r, k in findings)
    return TriggerProof(proven=False, cameras=(), findings=found)


def test_every_kind_but_an_ignored_trigger_is_a_doubt_with_an_action() -> None:
    """An ignored trigger only explains a missing frame."""
    assert set(get_args(Kind)) - set(ACTIONS) == {"ignored-trigger"}
    assert set(ACTIONS) >= QUESTIONING_KINDS
    assert doubtful(proof_of((0, 1, "ignored-trigger"))) == ()
    assert doubtful(None) == ()


def test_rows_of_one_camera_and_kind_are_one_sentence() -> None:
    doubts = doubts_of(
        proof_of((1, 4, "off-beat"), (1, 2, "off-beat"), (0, 3, "extra-frame"), (2, None, "runs-freely"))
    )
    assert doubts == (
        "trigger of camera 1, rows 2, 4: text of off-beat; these frames are not used",
        "trigger of camera 0, row 3: text of extra-frame",
        "trigger of camera 2: text of runs-freely; these frames are not used",
    )


@pytest.mark.parametrize("proof", [None, TriggerProof(proven=True, cameras=(), findings=())])
def test_a_proven_run_has_no_doubts(proof: TriggerProof | None) -> None:
    assert doubts_of(proof) == ()
