"""Cameras in colour: the ratios of red, green and blue of a white target, and what they make of pictures."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.photometry.white_recordings import DARK, EXPOSURE_US, HEIGHT, SHOT, WIDTH, shade
from vaoi_station.files import Recording, write_recording
from vaoi_station.model import RecordingHead
from vaoi_station.photometry.flat_fields import FlatFields, fitting_balances, write_flat_fields
from vaoi_station.photometry.measurement import measure_flat_fields
from vaoi_station.pixel_formats import PIXEL_FORMATS, picture

WARM = (1.0, 0.8, 0.4)
"""Red, green and blue that a camera sees of white under a warm lamp."""
RED = (1.0, 0.06, 0.02)


def filmed(level: NDArray[Any] | float, tint: tuple[float, ...], camera: int = 0, seed: int = 0) -> NDArray[Any]:
    """What a camera with a Bayer filter (RG) makes of a grey scene under a lamp with a tint, shaded and with noise."""
    mosaic = np.empty((HEIGHT, WIDTH))
    for (y, x), share in {(0, 0): tint[0], (0, 1): tint[1], (1, 0): tint[1], (1, 1): tint[2]}.items():
        mosaic[y::2, x::2] = share
    signal = level * shade(camera) * mosaic
    noise = np.random.default_rng(seed).standard_normal(signal.shape) * np.sqrt(1 + SHOT * signal)
    raw = np.clip(np.rint(signal + DARK + noise), 0, 255).astype(np.uint8)
    return picture(raw.ravel(), WIDTH, HEIGHT, PIXEL_FORMATS["BayerRG8"])


def recorded(directory: Path, level: float, tints: Mapping[str, tuple[float, ...]]) -> Recording:
    lights = [light for light in tints for _ in range(4)]
    head = RecordingHead.model_validate(
        {
            "format": "vaoi-recording", "version": 1, "rows": len(lights), "lights": lights, "trigger_period_s": 0.1,
            "cameras": [{"width": WIDTH, "height": HEIGHT, "exposure_us": EXPOSURE_US}] * 2,
            "conveyor_mm_s": [0, 100],
        }
    )  # fmt: skip
    return write_recording(
        directory,
        head,
        [(c, r, filmed(level, tints[light], c, 10 * r + c)) for c in (0, 1) for r, light in enumerate(lights)],
    )


@pytest.fixture(scope="module")
def fields(tmp_path_factory: pytest.TempPathFactory) -> FlatFields:
    """Flat fields under a warm and under a red lamp, written and read again."""
    directory = tmp_path_factory.mktemp("colour")
    tints = {"warm": WARM, "red": RED}
    measured = measure_flat_fields(
        recorded(directory / "white", 180, tints), recorded(directory / "dark", 0, dict.fromkeys(tints, WARM))
    )
    write_flat_fields(directory, measured)
    return FlatFields.open(directory)


def test_a_grey_card_under_a_warm_lamp_is_grey(fields: FlatFields) -> None:
    for camera in (0, 1):
        balance = fields.white_balances[camera, "warm"]
        assert balance.gains == pytest.approx((1.0, 1 / 0.8, 1 / 0.4), rel=0.01)
        card = filmed(70, WARM, camera, 99)
        assert np.ptp(card.mean((0, 1))) > 30
        balanced = balance.applied(card)
        assert balanced.dtype == np.uint8
        np.testing.assert_allclose(balanced.mean((0, 1)), card[..., 2].mean(), atol=0.6)
        deep = balance.applied(card.astype(np.uint16) * 257)
        np.testing.assert_allclose(deep / 257.0, balanced, atol=0.51)


def test_a_saturated_place_stays_white_and_darkness_dark(fields: FlatFields) -> None:
    balance = fields.white_balances[0, "warm"]
    ends = balance.applied(np.array([[[255, 255, 255], [3, 3, 3], [0, 0, 0]]], np.uint8))
    assert ends[0, 0].tolist() == [255, 255, 255]
    assert ends[0, 1].tolist() == [3, 3, 3]
    assert ends[0, 2].max() == 0
    grey = np.zeros((4, 4), np.uint8)
    assert balance.applied(grey) is grey


def test_nothing_is_balanced_under_a_coloured_lamp_nor_by_fields_without_colours(fields: FlatFields) -> None:
    assert {light for _, light in fields.white_balances} == {"warm"}
    assert fields.document is not None
    older = fields.document.model_dump(mode="json", exclude={"fields": {"__all__": {"white"}}})
    assert not FlatFields(type(fields.document).model_validate(older)).white_balances


def test_a_station_balances_no_run_that_its_flat_fields_do_not_fit(fields: FlatFields, tmp_path: Path) -> None:
    write_flat_fields(tmp_path, fields)
    head = recorded(tmp_path / "run", 70, {"warm": WARM}).head
    assert fitting_balances(tmp_path, head) == fields.white_balances
    other = head.model_copy(update={"cameras": head.cameras[:1]})
    assert [*map(len, (fitting_balances(tmp_path, other), fitting_balances(None, head)))] == [0, 0]
