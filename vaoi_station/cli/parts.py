"""The command parts: what is mounted on a board, compared with good boards."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any
from urllib.parse import quote

import typer

from vaoi_station.cli.options import BoardOf, CalibrationOf, CaseOf

if TYPE_CHECKING:
    from vaoi_station.demo.client import Client
    from vaoi_station.parts.learned import TaughtBoard
    from vaoi_station.parts.measure import Run

_KEPT_FRAMES = 96
"""Number of frames that are kept in memory, so that frames that show many parts are read once."""


def parts(
    case: CaseOf,
    out: Annotated[Path, typer.Option(help="Write the measures to this file (JSON).")],
    good: Annotated[
        list[Path] | None,
        typer.Option(help="Recording of a good board of this type, or its file of --keep; give it for each board."),
    ] = None,
    keep: Annotated[
        Path | None, typer.Option(help="Keep what good boards look like in this directory, one file a board.")
    ] = None,
    calibration: CalibrationOf = None,
    board: BoardOf = None,
) -> None:
    """Measure every part of a board: is it there, where, turned by how much, which way round, like good ones."""
    from vaoi_station.cli.opened_case import refuse_input
    from vaoi_station.errors import InputError
    from vaoi_station.files.documents import write_json
    from vaoi_station.parts.document import changes, dark_lights, disagreement_steps, measure_parts, parts_document
    from vaoi_station.parts.learned import merged, read_taught_board
    from vaoi_station.parts.measure import SoFar
    from vaoi_station.parts.models import Models
    from vaoi_station.steps import completed

    refuse_input(out, case, case / "result.json", calibration, board)
    for path in good or ():
        for read in (path, path / "result.json"):
            refuse_input(out, path, read, None, None)
    _refuse_wrong(good or [], keep)
    run, taken_with = _stitched(case, calibration, board)
    boards: list[TaughtBoard] = []
    for path in good or ():
        boards.append(read_taught_board(path) if path.is_file() else _taught(path, board, keep, boards))
    known = merged(boards)
    if others := [board.name for board in known if not board.is_of(run.board_type)]:
        raise InputError(
            f"good board {others[0]}: most of its parts are not those of board type {run.board_type.name!r}.",
            action="Give good boards of this type only.",
        )
    models = Models(known)
    so_far = SoFar()
    measured = measure_parts(run, models, so_far=so_far)
    disagreeing = completed(disagreement_steps(known))
    document = parts_document(
        run, models, measured, dark_lights(so_far) + changes(run, known, taken_with, case.resolve().name)
    )
    write_json(out, document | {"good_boards_disagree": disagreeing})
    said = [p["presence"] for p in measured.values() if p["presence"] is not None]
    absent = sum(p < 0.5 for p in said)
    marked = sum("marked" in p for p in measured.values())
    limits = f", {marked} beyond limits" if run.board_type.limits is not None else ""
    typer.echo(f"{len(measured)} part(s): {len(said)} measured, {absent} absent{limits} → {out}")
    _say_disagreements(disagreeing)
    for remark in document["remarks"]:
        typer.echo(f"- {remark}")


def teach_good(
    good: list[str], not_good: list[str], keep: Path | None, board: Path | None, station: Callable[[], Client]
) -> None:
    """Keep runs of a station, and recordings, as good boards; take runs out of those of the station."""
    from vaoi_station.errors import InputError
    from vaoi_station.parts.document import disagreement_steps
    from vaoi_station.steps import completed

    recordings = [Path(one) for one in good if Path(one).is_dir()]
    if recordings and keep is None:
        raise InputError(f"{recordings[0]}: is a recording, and --keep is missing.", action="Give it a directory.")
    _refuse_wrong(recordings, keep)
    boards: list[TaughtBoard] = []
    for path in recordings:
        boards.append(taught := _taught(path, board, keep, boards))
        typer.echo(f"{taught.name}: {sum(map(len, taught.addresses))} part(s) are kept → {keep}")
    _say_disagreements(completed(disagreement_steps(boards)))
    wanted = [("PUT", run) for run in good if not Path(run).is_dir()] + [("DELETE", run) for run in not_good]
    for method, run in wanted:
        reply = station().act("PUT" if method == "PUT" else "DELETE", f"/runs/{quote(run, safe='')}/good")
        what = "is kept as a good board" if method == "PUT" else "is no longer a good board"
        typer.echo(f"{run}: {what} of {reply['board_type']!r}, which has {len(reply['boards'])}.")
        for part in reply["absent"]:
            typer.echo(f"- {part} was measured as absent on it; is it right there?")
        _say_disagreements(reply["disagreements"])


def _say_disagreements(found: list[dict[str, Any]]) -> None:
    for one in found:
        typer.echo(f"- good board {one['board']}: {one['part']} looks unlike others of its kind; is it right there?")


def _taught(path: Path, board: Path | None, keep: Path | None, others: list[TaughtBoard]) -> TaughtBoard:
    """Return what a recording of a good board looks like, and keep it in the directory `keep`, if there is one."""
    from vaoi_station.parts.learned import ENDING, TaughtBoard, parts_digest
    from vaoi_station.parts.models import Models

    run, calibration = _stitched(path, None, board)
    name, patches = path.resolve().name, run.cut_on_tops(run.board_type.components, Models(others).heights_mm)
    taught = TaughtBoard.of_run(name, patches, parts_digest(run.board_type), calibration)
    if keep is not None:
        taught.write(keep / f"{name}{ENDING}")
    return taught


def _refuse_wrong(good: list[Path], keep: Path | None) -> None:
    """Raise InputError if a good board is missing or would be kept over another one, or if two have one name.

    Of two with one name only one would count, and be kept.
    """
    from vaoi_station.errors import InputError
    from vaoi_station.parts.learned import ENDING

    known: dict[str, Path] = {}
    for path in good:
        if not path.exists():
            raise InputError(f"{path}: is neither a recording nor a file of --keep.", action="Give the path of one.")
        if path.is_dir() and keep is not None and (kept := keep / f"{path.resolve().name}{ENDING}").exists():
            raise InputError(f"{kept}: exists already.", action="Remove it, or give it by --good.")
        if path.is_dir() and known.setdefault(path.resolve().name, path).resolve() != path.resolve():
            raise InputError(
                f"{path}: has the same name as another good board, {known[path.resolve().name]}.",
                action="Rename one of the directories.",
            )


def _stitched(case: Path, calibration: Path | None, board: Path | None) -> tuple[Run, str]:
    """Open a recording with its result, which is computed if there is none; also return its calibration's digest."""
    from vaoi_station.errors import InputError
    from vaoi_station.library.recordings import open_recording
    from vaoi_station.parts.measure import Run
    from vaoi_station.stitching.recordings.origin import KEY

    recorded = open_recording(case, calibration=calibration, board_type=board)
    result = case / "result.json"
    run = recorded.with_result(result) if result.is_file() else recorded.stitch()
    if run.board_type is None:
        raise InputError(f"{case}: has no board type.", action="Add board.json, or give --board.")
    if not run.board_type.components:
        raise InputError(f"{case}: its board type has no parts.", action="Give the whole board type by --board.")
    if run.result.cad_matrix is None:
        why = f": {'; '.join(run.reasons)}" if run.reasons else ""
        raise InputError(
            f"{case}: is not placed by its CAD data, so it is not known where its parts are{why}.",
            action="Stitch it again with its board type, or film the board again.",
        )
    frame = lru_cache(_KEPT_FRAMES)(run.recording.frame)
    digest = str((run.result.quality.get(KEY) or {}).get("calibration", ""))
    return Run(run.board_type, run.result, run.cameras, run.recording.head, frame), digest
