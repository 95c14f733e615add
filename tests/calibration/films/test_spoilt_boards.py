"""Hidden, dirty and scratched marks of plain grids: never off by a spacing, and the stated corners are true."""

from __future__ import annotations

import numpy as np
import pytest

from tests.calibration.films.spoilt_boards import (
    SPOILS,
    Spoil,
    Variant,
    corner_errors,
    frame_of_tape,
)

_SPACING_PX = 60.0
"""The least spacing of the grids, px."""


@pytest.mark.parametrize("spoil", SPOILS, ids=lambda s: s.__name__)
def test_a_spoilt_grid_is_never_calibrated_off_by_a_spacing(spoil: Spoil) -> None:
    for grid in (5, 7):
        variant = Variant(grid, spoil, 2)
        outcome = variant.calibrate()
        if outcome.refused:
            continue
        errors, sigmas = corner_errors(variant.twin, outcome)
        assert errors.max() < 5 < _SPACING_PX, variant.name
        assert (errors < 5 * sigmas).all(), variant.name


def test_hidden_rims_do_not_make_the_stated_corners_wrong() -> None:
    """rms of error / σ within a factor of two, of those that were calibrated."""
    ratios = []
    for spoil in SPOILS[:6]:
        variant = Variant(7, spoil, 1)
        outcome = variant.calibrate()
        if not outcome.refused:
            errors, sigmas = corner_errors(variant.twin, outcome)
            ratios.append((errors / sigmas).ravel())
    assert len(ratios) >= 4
    assert 0.5 < np.sqrt((np.concatenate(ratios) ** 2).mean()) < 2


def test_an_ambiguous_grid_is_refused_with_its_remedy_and_no_other_layout_is_proposed() -> None:
    error = Variant(7, frame_of_tape, 2).calibrate().error()
    assert "its marks fit the layout in two ways: shifted by (0.0, " in error.message
    assert "--center-tolerance-mm" in error.action
    assert "write layout.json" not in error.action
