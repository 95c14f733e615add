"""Write a run from the ring as a recording on disk, completely or not at all."""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Mapping
from pathlib import Path

from vaoi_station.acquisition.process.messages import RunFinished
from vaoi_station.acquisition.ring.ring import Ring
from vaoi_station.files import Recording, open_recording, write_recording
from vaoi_station.files.atomic_directory import new_directory
from vaoi_station.files.images import Image
from vaoi_station.model import RecordingHead


def export_run(
    directory: Path, finished: RunFinished, ring: Ring, generation: int, copies: Mapping[str, Path] | None = None
) -> Recording:
    """Write a finished run as the recording `directory`, which must not exist yet.

    Args:
        directory: path of the new recording, which appears there only when it is complete.
        finished: the run; frames that are not usable are listed under `missing`, with causes under `x_verdicts`.
        ring: the ring that holds the frames of the run.
        generation: generation of the run's bay.
        copies: name in the recording → file to copy there ("calibration.json", "board.json").

    Raises:
        GoneError: the memory was given to another board meanwhile.
        InputError: the directory exists already.
    """
    with new_directory(directory) as draft:
        for name, source in (copies or {}).items():
            shutil.copyfile(source, draft / name)
        write_recording(draft, recording_head(finished), _frames(finished, ring, generation))
    return open_recording(directory)


def recording_head(finished: RunFinished) -> RecordingHead:
    """Return the head of the recording of a finished run.

    Faults and the proof are stored under `x_` keys, which other readers ignore.
    """
    document = finished.head.model_dump(mode="json", exclude_none=True)
    document["x_run"] = finished.run
    document["x_ended"] = finished.reason
    document["x_verdicts"] = [
        {"camera": f.camera, "row": f.row, "verdict": str(f.verdict), "cause": f.cause}
        for f in finished.frames
        if not f.usable
    ]
    if finished.proof is not None:
        document["x_proof"] = finished.proof.model_dump(mode="json")
    return RecordingHead.model_validate(document)


def _frames(finished: RunFinished, ring: Ring, generation: int) -> Iterator[tuple[int, int, Image]]:
    for frame in finished.frames:
        if frame.usable and frame.slot is not None:
            yield frame.camera, frame.row, ring.snapshot(frame.slot, generation)
