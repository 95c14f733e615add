"""The doubts that a proof leaves about a run: sentences for its verdict, and an action for each kind of finding."""

from __future__ import annotations

from collections.abc import Mapping

from vaoi_station.acquisition.pairing.proof import QUESTIONING_KINDS, Kind, TriggerFinding, TriggerProof

ACTIONS: Mapping[Kind, str] = {
    "runs-freely": (
        "Check by vaoi doctor that the camera is in trigger mode and listens to the input to which the trigger is "
        "wired, then film the board again."
    ),
    "off-beat": "Check the camera's trigger line for interference, then film the board again.",
    "clock-jumped": (
        "Switch off what sets the camera's clock (PTP, IEEE 1588, another program) and check its power, then film the "
        "board again."
    ),
    "latency-changed": (
        "Film the board again: the latency that was found is used from now on. If it stays as it is, write it to "
        "latency_us of the camera in station.toml."
    ),
    "latency-ambiguous": (
        "Film the board again: a run with a frame of its first pulse settles it. Or write the camera's latency to "
        "latency_us of the camera in station.toml."
    ),
    "exchanged": "Film the board again; report it with the proof of the run if it returns.",
    "early": "Film the board again; report it with the proof of the run if it returns.",
    "miscounted": "Check the camera's setting of the frame id, then film the board again.",
    "other-light": (
        "Film the board again. If it returns, check the wiring of the LED channels, and the trigger line of a camera "
        "whose sequencer is a row off; with a replay, use a program that fits the recording."
    ),
    "extra-frame": "Check the trigger line for bounces and crosstalk.",
}
"""For each kind of finding that makes a run doubtful, the action. Kinds without an entry only explain missing
frames."""


def doubtful(proof: TriggerProof | None) -> tuple[TriggerFinding, ...]:
    """Return the findings that leave a doubt about the frames of a run; the others only explain missing frames."""
    return tuple(f for f in proof.findings if f.kind in ACTIONS) if proof is not None else ()


def doubts_of(proof: TriggerProof | None) -> tuple[str, ...]:
    """Return one sentence for each camera and kind of doubtful finding, for the head of the recording."""
    grouped: dict[tuple[int, Kind], list[TriggerFinding]] = {}
    for finding in doubtful(proof):
        grouped.setdefault((finding.camera, finding.kind), []).append(finding)
    return tuple(_sentence(camera, kind, found) for (camera, kind), found in grouped.items())


def _sentence(camera: int, kind: Kind, found: list[TriggerFinding]) -> str:
    rows = sorted({f.row for f in found if f.row is not None})
    where = f", row{'s' if len(rows) > 1 else ''} {', '.join(map(str, rows))}" if rows else ""
    unused = "; these frames are not used" if kind in QUESTIONING_KINDS else ""
    return f"trigger of camera {camera}{where}: {found[0].text}{unused}"
