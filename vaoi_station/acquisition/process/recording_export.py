"""A run in the ring → a recording on the disk, whole or not at all."""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Mapping
from pathlib import Path

from vaoi_station.acquisition.process.messages import RunFinished
from vaoi_station.acquisition.ring.ring import Ring
from vaoi_station.files import Recording, open_recording, write_recording
from vaoi_station.files.atomic_directory import new_directory
from vaoi_station.files.images import Image
from vaoi_station.model import RecordingHead, Verdict


def keep_run(
    directory: Path, finished: RunFinished, ring: Ring, generation: int, copies: Mapping[str, Path] | None = None
) -> Recording:
    """Write a finished run as the recording `directory`, which must not exist yet.

    Args:
        directory: appears complete, by a rename, or not at all.
        finished: the run; what is not ok is listed under `missing`, with its cause under `x_verdicts`.
        ring: where its frames are.
        generation: of its bay; `GoneError` if the memory goes to another board meanwhile.
        copies: name in the recording → file to copy there ("calibration.json", "board.json").
    """
    with new_directory(directory) as draft:
        for name, source in (copies or {}).items():
            shutil.copyfile(source, draft / name)
        write_recording(draft, recording_head(finished), _frames(finished, ring, generation))
    return open_recording(directory)


def recording_head(finished: RunFinished) -> RecordingHead:
    """The head of the recording, with what went wrong in keys of our own."""
    document = finished.head.model_dump(mode="json", exclude_none=True)
    document["x_run"] = finished.run
    document["x_ended"] = finished.reason
    document["x_verdicts"] = [
        {"camera": f.camera, "row": f.row, "verdict": str(f.verdict), "cause": f.cause}
        for f in finished.frames
        if f.verdict is not Verdict.OK
    ]
    if finished.proof is not None:
        document["x_proof"] = finished.proof.model_dump(mode="json")
    return RecordingHead.model_validate(document)


def _frames(finished: RunFinished, ring: Ring, generation: int) -> Iterator[tuple[int, int, Image]]:
    for frame in finished.frames:
        if frame.verdict is Verdict.OK and frame.slot is not None:
            yield frame.camera, frame.row, ring.snapshot(frame.slot, generation)
