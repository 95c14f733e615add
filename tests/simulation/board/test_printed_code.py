"""Labels of the twin: symbols of the standards, at their place, with the serial number of the board."""

from __future__ import annotations

import numpy as np
import pytest
from pydantic import ValidationError

from vaoi_station.simulation.board.printed_code import (
    QUIET_MODULES,
    code_text,
    draw_label,
    identity_of,
    symbol,
)
from vaoi_station.simulation.scenario import BoardSection, CodeSection

CODE = CodeSection(x_mm=10.0, y_mm=8.0, module_mm=0.3)


def test_datamatrix_has_the_finder_pattern_of_the_standard() -> None:
    """ISO/IEC 16022: the left and the lower edge are dark, the upper and the right one alternate; 10 to 144 modules."""
    dark = symbol("datamatrix", "demo;SN000001")
    count = len(dark)
    assert dark.shape == (count, count)
    assert count in (16, 18, 20)
    assert dark[:, 0].all()
    assert dark[-1].all()
    alternating = np.arange(count) % 2 == 0
    assert (dark[0] == alternating).all()
    assert (dark[:, -1] == ~alternating).all()


def test_qr_code_has_its_three_finder_patterns() -> None:
    dark = symbol("qr", "demo;SN000001")
    ring = np.ones((7, 7), np.bool_)
    ring[1:6, 1:6] = False
    ring[2:5, 2:5] = True
    assert len(dark) % 4 == 1
    for corner in (dark[:7, :7], dark[:7, -7:], dark[-7:, :7]):
        assert (corner == ring).all()


def test_text_has_type_and_serial_number() -> None:
    assert code_text(CODE, "demo", 4) == "demo;SN000005"


@pytest.mark.parametrize("turned", [0.0, 30.0, 90.0])
@pytest.mark.parametrize("inverted", [False, True])
def test_label_lies_at_its_place_with_its_size(turned: float, inverted: bool) -> None:
    label = draw_label(CODE.model_copy(update={"turned_deg": turned, "inverted": inverted}), "demo", 0, 20.0)
    cover = label.cover / 255.0
    side = (len(symbol("datamatrix", code_text(CODE, "demo", 0))) + 2 * QUIET_MODULES) * CODE.module_mm
    assert side == pytest.approx((len(symbol("datamatrix", "demo;SN000001")) + 2 * QUIET_MODULES) * 0.3)
    assert cover.sum() / 20.0**2 == pytest.approx(side**2, rel=0.01)
    rows, columns = np.mgrid[: cover.shape[0], : cover.shape[1]]
    middle = np.array([(cover * columns).sum(), (cover * rows).sum()]) / cover.sum()
    assert np.abs(middle - label.to_px(np.array([10.0, 8.0]))).max() < 0.1
    border = label.top[cover > 0.99]
    assert set(np.unique(border[(border == border.min()) | (border == border.max())])) == {40, 205}


def test_label_is_turned_counter_clockwise() -> None:
    """The corner of the two dark edges lies at the lower left; turned by 90° it lies at the lower right."""
    upright, turned = (draw_label(CODE.model_copy(update={"turned_deg": d}), "demo", 0, 20.0).top for d in (0.0, 90.0))
    assert np.abs(np.rot90(upright).astype(float) - turned).mean() < 8
    assert np.abs(np.rot90(upright, -1).astype(float) - turned).mean() > 30


@pytest.mark.parametrize("turned", [0.0, 30.0])
def test_code_of_dots_has_a_disk_in_the_middle_of_every_dark_module(turned: float) -> None:
    solid = CODE.model_copy(update={"turned_deg": turned})
    dark = [205.0 - draw_label(code, "demo", 0, 40.0).top[20:-20, 20:-20].astype(float)
            for code in (solid, solid.model_copy(update={"dot_modules": 0.7}))]  # fmt: skip
    assert dark[1].sum() / dark[0].sum() == pytest.approx(np.pi / 4 * 0.7**2, rel=0.02)
    middles = [np.array(np.nonzero(d > 80)).mean(1) for d in dark]
    assert np.abs(middles[0] - middles[1]).max() < 0.3


def test_board_type_states_places_and_the_common_pattern() -> None:
    board = BoardSection(name="b", width_mm=40.0, length_mm=30.0, unit="inch", codes=(CODE,))
    found = identity_of(board)
    assert found is not None
    assert found.pattern == "b;{id}"
    assert found.places[0].center == pytest.approx((10 / 25.4, 22 / 25.4))
    two = board.model_copy(update={"codes": (CODE, CODE.model_copy(update={"text": "{serial}", "panel": 2}))})
    found = identity_of(two)
    assert found is not None
    assert found.pattern is None
    assert [p.panel for p in found.places] == [None, 2]
    assert identity_of(BoardSection()) is None


def test_code_off_the_board_or_without_serial_number_is_refused() -> None:
    with pytest.raises(ValidationError, match=r"a code at \(10.0, 8.0\) mm lies off the board of 9.0"):
        BoardSection(width_mm=9.0, codes=(CODE,))
    with pytest.raises(ValidationError, match=r"must contain .serial."):
        BoardSection(codes=(CODE.model_copy(update={"text": "demo"}),))
