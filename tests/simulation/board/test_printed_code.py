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
