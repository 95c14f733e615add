"""The mosaic of a recording: flat fields of another array, and a document that cannot be written."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import vaoi_station as vaoi
from vaoi_station.errors import DeviceError, InputError
from vaoi_station.library import mosaic_file
from vaoi_station.library.mosaic_file import MosaicOrder, write_board
from vaoi_station.photometry.flat_fields import FlatFieldDocument, FlatFields, write_flat_fields


@pytest.fixture(scope="module")
def order(
    recording: vaoi.RecordedRun, stitched: vaoi.StitchedRun, tmp_path_factory: pytest.TempPathFactory
) -> MosaicOrder:
    directory = tmp_path_factory.mktemp("mosaic")
    stitched.save(directory / "result.json")
    return MosaicOrder(recording.directory, directory / "result.json", directory / "board.tif", px_per_mm=5.0)


def test_flat_fields_of_another_array_are_refused_with_both_numbers(order: MosaicOrder, tmp_path: Path) -> None:
    document = FlatFieldDocument.model_validate(
        {
            "format": "vaoi-flatfield",
            "version": 1,
            "cameras": [{"width": 32, "height": 16, "read": 1.0, "shot": 0.02}],
            "fields": [{"camera": 0, "file": "fields/c00.tiff", "level": 1.0, "rows": 8}],
        }
    )
    write_flat_fields(tmp_path, FlatFields(document, {(0, None): np.ones((16, 32), np.float32)}))
    wrong = MosaicOrder(order.case, order.result, tmp_path / "b.tif", flatfield=tmp_path)
    with pytest.raises(InputError, match=r"are of an array of 1 cameras, but \d+ cameras were filming"):
        list(write_board(wrong))
    assert not wrong.out.exists()


def test_picture_is_removed_if_its_document_cannot_be_written(
    order: MosaicOrder, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(path: Path, content: object) -> None:
        raise DeviceError(f"{path}: cannot be written (No space left on device).")

    monkeypatch.setattr(mosaic_file, "write_json", full)
    with pytest.raises(DeviceError, match=r"board.tif.json: cannot be written .*\. board.tif was removed again"):
        list(write_board(order))
    assert not order.out.exists()
    assert not order.document.exists()
