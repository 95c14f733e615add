"""Read and write recordings."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from vaoi_station.errors import InputError
from vaoi_station.files import Recording, open_recording, write_recording
from vaoi_station.files.images import write_image
from vaoi_station.model import RecordingHead

Change = Callable[[dict[str, Any]], object]


def rewrite(recording: Recording, change: Change) -> Path:
    path = recording.directory / "recording.json"
    document = json.loads(path.read_text())
    change(document)
    path.write_text(json.dumps(document))
    return recording.directory


def test_recording_round_trips(recording: Recording) -> None:
    again = open_recording(recording.directory)
    assert again.head == recording.head
    assert again.frame(1, 2) is None
    assert again.frame_path(1, 2) is None
    frame = again.frame(1, 1)
    assert frame is not None
    assert frame.shape == (20, 32)
    np.testing.assert_array_equal(frame, recording.frame(1, 1))


def test_missing_file_is_named_with_a_remedy(recording: Recording) -> None:
    path = recording.frame_path(0, 1)
    assert path is not None
    path.unlink()
    with pytest.raises(InputError, match=r"c00_r001\.png: the frame is absent .* add \[0, 1\] to 'missing'"):
        open_recording(recording.directory)


def test_frame_of_the_wrong_size_is_refused(recording: Recording) -> None:
    path = recording.frame_path(1, 0)
    assert path is not None
    write_image(path, np.zeros((32, 20), np.uint8))
    with pytest.raises(InputError, match=r"c01_r000\.png: is 20×32 px, but recording\.json says 32×20 px for camera 1"):
        recording.frame(1, 0)


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        (lambda d: d.update(format="vaoi-stitch"), "format is 'vaoi-stitch'"),
        (lambda d: d.update(version=2), "version is 2, but must be 1. Use a newer"),
        (lambda d: d["cameras"][1].update(width=4), r"cameras\.1\.width: .* 16 \(given: 4\)"),
        (lambda d: d.update(trigger_period_s=float("nan")), "trigger_period_s is nan"),
    ],
)
def test_faulty_head_is_refused_with_file_and_key(recording: Recording, change: Change, complaint: str) -> None:
    with pytest.raises(InputError, match=rf"recording\.json: .*{complaint}|recording\.json: {complaint}"):
        open_recording(rewrite(recording, change))


def test_recording_that_is_being_replaced_has_no_head(recording: Recording) -> None:
    """The head is removed first and written last, because a directory with a head is complete."""
    path = recording.directory / "recording.json"

    def frames() -> Any:
        assert not path.exists()
        yield from ()
        raise OSError(28, "No space left on device")

    with pytest.raises(OSError, match="No space"):
        write_recording(recording.directory, recording.head, frames())
    assert not path.exists()


def test_head_that_lists_absent_frames_is_refused(tmp_path: Path, recording: Recording) -> None:
    head = RecordingHead.model_validate(recording.head.model_dump())
    with pytest.raises(InputError, match="the frame is absent"):
        write_recording(tmp_path / "empty", head, [])


def deep(tmp_path: Path, levels: list[list[int]], **camera: Any) -> Recording:
    """Write a recording of 16-bit frames; `levels` holds the largest value of each camera's frames."""
    head = RecordingHead.model_validate(
        {
            "format": "vaoi-recording", "version": 1, "rows": len(levels[0]), "trigger_period_s": 0.1,
            "conveyor_mm_s": [0, 100], "cameras": [{"width": 32, "height": 20, "exposure_us": 100.0} | camera] * 2,
        }
    )  # fmt: skip
    ramp = np.linspace(0, 1, 640).reshape(20, 32)
    frames = [
        (i, j, np.round(ramp * top).astype(np.uint16)) for i, tops in enumerate(levels) for j, top in enumerate(tops)
    ]
    return write_recording(tmp_path / "deep", head, frames)


def brightest(recording: Recording, camera: int, row: int) -> int:
    frame = recording.frame(camera, row)
    assert frame is not None
    return int(frame.max())


def test_all_16_bit_frames_of_a_recording_have_one_scale(tmp_path: Path) -> None:
    """A dark frame stays dark: the scale is not that of its own brightest pixel."""
    recording = deep(tmp_path, [[4095, 1000], [200, 2047]])
    assert [brightest(recording, 0, 0), brightest(recording, 0, 1)] == [65535, 1000 << 4 | 1000 >> 8]
    assert [brightest(recording, 1, 0), brightest(recording, 1, 1)] == [200 << 4, 2047 << 4 | 2047 >> 8]


def test_a_value_beyond_the_stated_bits_is_refused(tmp_path: Path) -> None:
    recording = deep(tmp_path, [[4096], [200]], bits=12)
    with pytest.raises(InputError, match=r"c00_r000.*pixel value 4096, but recording.json says 12 bits \(limit 4095\)"):
        recording.frame(0, 0)


def test_another_rotation_is_kept_in_a_copy_of_the_head(recording: Recording, tmp_path: Path) -> None:
    assert recording.with_rotation(None) is recording
    turned = recording.with_rotation(270)
    assert (turned.head.rotation_deg, turned.directory) == (270, recording.directory)
    recording.copy_head(tmp_path)
    own = (recording.directory / "recording.json").read_bytes()
    assert (tmp_path / "recording.json").read_bytes() == own
    turned.copy_head(tmp_path)
    assert json.loads((tmp_path / "recording.json").read_text()) == json.loads(own) | {"rotation_deg": 270}
    with pytest.raises(InputError, match="the rotation is 45, but must be 0, 90, 180 or 270"):
        recording.with_rotation(45)
