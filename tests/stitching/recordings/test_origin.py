"""A result knows from which recording it was made, and is refused for another one."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest

from vaoi_station.errors import InputError
from vaoi_station.files import open_recording, read_board_type, read_calibration
from vaoi_station.files.images import encode_tiff, read_image
from vaoi_station.model import Status, Stitch
from vaoi_station.simulation import Twin, read_scenario, scenario_path
from vaoi_station.simulation.recording_writer import write_passage
from vaoi_station.stitching.recordings.origin import KEY, cad_digest, check_origin, with_origin

RESULT = Stitch(method="auto", image_matrices=((), ()), cad_matrix=None, row_motion=(), status=Status.OK)


@pytest.fixture(scope="module")
def boards(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Recordings of two boards of one array: same calibration, same board type, same number of rows."""
    twin, folder = Twin(read_scenario(scenario_path("small"))), tmp_path_factory.mktemp("boards")
    for n in (0, 1):
        write_passage(twin.passage(n), folder / f"board-{n}", with_truth=False)
    return folder / "board-0", folder / "board-1"


def stamped(case: Path) -> Stitch:
    return with_origin(RESULT, *parts(case))


def parts(case: Path) -> tuple[Any, Any, Any]:
    return open_recording(case), read_calibration(case / "calibration.json"), read_board_type(case / "board.json")


def test_a_copy_under_another_name_in_another_image_format_is_the_same_recording(
    boards: tuple[Path, Path], tmp_path: Path
) -> None:
    copy = Path(shutil.copytree(boards[0], tmp_path / "copy"))
    for path in list((copy / "frames").iterdir()):
        path.with_suffix(".tiff").write_bytes(encode_tiff(read_image(path)))
        path.unlink()
    check_origin(stamped(boards[0]), *parts(copy), "r.json")


def test_another_calibration_is_refused_also_if_only_a_lens_differs(boards: tuple[Path, Path]) -> None:
    recording, calibration, board_type = parts(boards[0])
    other = calibration.model_copy(update={"working_distance_mm": 301.0})
    with pytest.raises(InputError, match="with another calibration"):
        check_origin(stamped(boards[0]), recording, other, board_type, "r.json")
    later = calibration.model_copy(update={"created": "2026-01-01", "residual_px": None})
    check_origin(stamped(boards[0]), recording, later, board_type, "r.json")


def test_cad_data_on_which_the_mapping_depends_must_agree(boards: tuple[Path, Path]) -> None:
    recording, calibration, board_type = parts(boards[0])
    result = stamped(boards[0])
    other = board_type.model_copy(update={"name": "other", "side": "bottom"})
    with pytest.raises(
        InputError, match=r"board type 'small', and the one given, 'other', differs in one of fiducials"
    ):
        check_origin(result, recording, calibration, other, "r.json")
    fewer = board_type.model_copy(update={"components": board_type.components[:1]})
    check_origin(result, recording, calibration, fewer, "r.json")
    check_origin(result, recording, calibration, None, "r.json")


def test_a_result_of_a_version_without_kinds_of_fiducials_is_accepted() -> None:
    """The result was made by such a version; newer keys must not change the digest of its CAD data."""
    corpus = Path(__file__).parents[2] / "fuzz" / "corpus"
    older = json.loads((corpus / "result" / "tiny").read_text())
    assert cad_digest(read_board_type(corpus / "board" / "tiny")) == older["quality"][KEY]["cad_data"]


@pytest.mark.parametrize("garbage", [None, 5, {}, {"name": "a"}])
def test_an_unreadable_origin_is_refused(boards: tuple[Path, Path], garbage: Any) -> None:
    result = RESULT.model_copy(update={"quality": {KEY: garbage}})
    with pytest.raises(InputError, match=r"r\.json: quality\.recording"):
        check_origin(result, *parts(boards[0]), "r.json")
