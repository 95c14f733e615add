"""A bundle holds everything that is needed to stitch a run again."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from vaoi_station.errors import InputError
from vaoi_station.files import open_recording, read_stitch
from vaoi_station.files.results import stitch_document
from vaoi_station.reporting import StitchedRun, report, restitch, write_bundle
from vaoi_station.reporting.report import replay_command
from vaoi_station.stitching.recordings.opening import open_run
from vaoi_station.stitching.recordings.references import teach


def result_of(stitched: StitchedRun) -> dict[str, object]:
    """Return the result without its timings and the name of the recording, which is that of the directory."""
    document = stitch_document(stitched.result)
    del document["quality"]["timings_ms"], document["quality"]["recording"]["name"]
    return document


def test_bundle_stitched_again_gives_the_same_result(stitched: StitchedRun, tmp_path: Path) -> None:
    kept = tmp_path / "kept"
    write_bundle(kept, stitched)
    held = {"recording.json", "frames", "calibration.json", "board.json", "result.json", "links.npz", "report.html"}
    assert {p.name for p in kept.iterdir()} == held, "and no truth"
    assert len(list((kept / "frames").iterdir())) == len(stitched.opened.present)
    assert open_recording(kept).head == stitched.head
    assert result_of(restitch(open_run(kept))) == result_of(stitched)
    assert stitch_document(read_stitch(kept / "result.json")) == stitch_document(stitched.result)
    assert replay_command(kept, stitched) == f"vaoi stitch {kept} --method auto --out again.json"


def test_links_are_arrays_of_one_length(stitched: StitchedRun, tmp_path: Path) -> None:
    write_bundle(tmp_path / "kept", stitched)
    with np.load(tmp_path / "kept" / report.LINKS, allow_pickle=False) as arrays:
        links = {k: arrays[k] for k in arrays.files if not k.startswith("sighting_")}
        sightings = {k: arrays[k] for k in arrays.files if k.startswith("sighting_")}
    count = stitched.result.quality["links"]
    used = count["rows"]["used"] + count["neighbours"]["used"]
    assert {len(v) for v in links.values()} == {count["rows"]["found"] + count["neighbours"]["found"]}
    assert int((links["weight"] > 0.1).sum()) == used
    same_camera = links["a"][:, 0] == links["b"][:, 0]
    assert np.array_equal(same_camera, links["between_cameras"] == 0)
    median = np.median(np.hypot(*links["residual_px"][links["weight"] > 0.1].T))
    assert median == pytest.approx(stitched.result.quality["residual_px"]["median"], abs=1e-4)
    assert len({len(v) for v in sightings.values()}) == 1


def test_reference_is_part_of_the_bundle(run: Path, tmp_path: Path) -> None:
    teach(run, run / "calibration.json", run / "board.json", tmp_path / "taught")
    stitched = restitch(open_run(run, reference=tmp_path / "taught", method="reference"))
    kept = tmp_path / "kept"
    write_bundle(kept, stitched)
    assert not list(kept.rglob("truth.json"))
    assert replay_command(kept, stitched).endswith(
        f"--method reference --reference {kept / 'reference'} --out again.json"
    )
    again = restitch(open_run(kept, reference=kept / "reference", method="reference"))
    assert result_of(again) == result_of(stitched)


def test_nothing_is_overwritten_or_left_incomplete(
    stitched: StitchedRun, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "there").mkdir()
    with pytest.raises(InputError, match="exists already"):
        write_bundle(tmp_path / "there", stitched)

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(report, "write_report", full)
    with pytest.raises(OSError, match="No space"):
        write_bundle(tmp_path / "new", stitched)
    assert [p.name for p in tmp_path.iterdir()] == ["there"]
