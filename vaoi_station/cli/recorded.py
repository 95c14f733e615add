"""The commands that work on one recording: simulate, stitch, teach, report, mosaic, heights, identify, check-board."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from vaoi_station.cli.options import (
    STATION,
    BoardOf,
    CalibrationOf,
    CaOf,
    CaseOf,
    FlatFieldOf,
    KeyFileOf,
    ReferenceOf,
    ResultOf,
    RotationOf,
    StationOf,
    client_of,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from vaoi_station.board_check.report import BoardCheck


def simulate(
    scenario: Annotated[
        str,
        typer.Argument(
            help="Scenario file (TOML), or the name of a shipped scenario: demo, light, small. A file takes precedence "
            "over a shipped scenario of the same name; a folder does not."
        ),
    ] = "demo",
    *,
    out: Annotated[Path, typer.Option(help="Write the recording to this directory; it is created if necessary.")],
    board: Annotated[int, typer.Option(min=0, help="Film this board of the scenario, counted from 0.")] = 0,
    truth: Annotated[bool, typer.Option(help="Write truth.json, with which results can be compared.")] = True,
    calibration_board: Annotated[
        bool, typer.Option("--calibration-board", help="Film the calibration board instead, and write its layout.json.")
    ] = False,
) -> None:
    """Film a board with simulated cameras; write recording, calibration, board type and truth."""
    from vaoi_station.errors import InputError
    from vaoi_station.simulation import Twin, find_scenario, read_scenario
    from vaoi_station.simulation.calibration_board import write_calibration_recording
    from vaoi_station.simulation.recording_writer import write_passage

    # Frames of two boards in one directory would be taken for one recording.
    if (out / "recording.json").exists():
        raise InputError(f"{out}: already holds a recording.", action="Give another --out, or remove this directory.")
    twin = Twin(read_scenario(find_scenario(scenario)))
    if calibration_board:
        recording = write_calibration_recording(twin, out, with_truth=truth)
        print(f"{out}: calibration board, {len(recording.head.cameras)} cameras")
        return
    recording = write_passage(twin.passage(board), out, with_truth=truth)
    head, missing = recording.head, len(recording.head.missing)
    lost = f", {missing} frames missing" if missing else ""
    print(f"{out}: board {board} of {twin.board_type.name!r}, {len(head.cameras)} cameras × {head.rows} rows{lost}")


Evidence = Literal["auto", "fiducials", "features", "reference"]


def stitch(
    case: CaseOf,
    out: Annotated[Path, typer.Option(help="Write the result to this file.")],
    calibration: CalibrationOf = None,
    board: BoardOf = None,
    reference: ReferenceOf = None,
    method: Annotated[
        Literal["auto", "fiducials", "features", "reference", "paper"],
        typer.Option(help="Use this evidence, or the paper's method."),
    ] = "auto",
    rotation: RotationOf = None,
) -> None:
    """Stitch a recorded run: compute one matrix per frame, and C from CAD to tester."""
    from vaoi_station.errors import InputError
    from vaoi_station.files import write_stitch
    from vaoi_station.stitching.paper_method import stitch_by_paper
    from vaoi_station.stitching.recordings.opening import open_run
    from vaoi_station.stitching.recordings.origin import ESTIMATED_BITS, with_origin
    from vaoi_station.stitching.work import stitch_frames

    # The paper's method does not use this kind of evidence, but opening a run requires one.
    evidence: Evidence = "auto" if method == "paper" else method
    opened = open_run(
        case, calibration=calibration, board=board, reference=reference, method=evidence, rotation_deg=rotation
    )
    recording = opened.recording
    # Overwriting one of these input files with the result would make the recording unusable.
    if out.resolve() in {(case / name).resolve() for name in ("recording.json", "calibration.json", "board.json")}:
        raise InputError(f"{out}: is a file of the recording and is not overwritten.", action="Give another --out.")
    if method == "paper":
        result = stitch_by_paper(opened.setup, recording.head, recording.frame)
    else:
        reference_frame = opened.reference.recording.frame if opened.reference else None
        result = stitch_frames(opened.setup, recording.head, recording.frame, reference_frame)
    result = with_origin(result, recording, opened.calibration, opened.setup.board_type)
    write_stitch(out, result)
    sigma = result.quality.get("cad_sigma_px")
    typer.echo(f"{result.status}: {recording.head.rows} rows × {len(recording.head.cameras)} cameras → {out}")
    if sigma is not None:
        typer.echo(f"standard deviation of positions: {sigma:.3f} px (worst corner of the board)")
    if (bits := result.quality.get(ESTIMATED_BITS)) is not None:
        typer.echo(f"frames use {bits} of 16 bits, by an estimate: state cameras[].bits in recording.json")
    for reason in result.reasons:
        typer.echo(f"- {reason}")


def teach(
    case: Annotated[Path | None, typer.Argument(help="Recording (a directory) that becomes a reference.")] = None,
    out: Annotated[
        Path | None, typer.Option(help="Write the reference to this directory, which must not exist.")
    ] = None,
    good: Annotated[
        list[str] | None,
        typer.Option(help="Keep this board as a good one: a run of the station, or a recording; give it for each."),
    ] = None,
    not_good: Annotated[
        list[str] | None, typer.Option(help="Remove this run from the good boards of the station.")
    ] = None,
    keep: Annotated[
        Path | None, typer.Option(help="Good recordings: keep what they look like here, one file a board.")
    ] = None,
    calibration: CalibrationOf = None,
    board: BoardOf = None,
    confirm_orientation: Annotated[
        bool,
        typer.Option(
            "--confirm-orientation",
            help="You have checked that the board lies as its board type says, not turned by 180°.",
        ),
    ] = False,
    rotation: RotationOf = None,
    station: StationOf = STATION,
    key_file: KeyFileOf = None,
    ca: CaOf = None,
) -> None:
    """Keep a recording as the reference of its board type, or boards as good ones with which parts are compared.

    With --good and --not-good the boards are runs of a station, or recordings, for `vaoi parts` on this machine.
    """
    from vaoi_station.errors import InputError

    if good or not_good:
        from vaoi_station.cli.parts import teach_good

        if case is not None or out is not None:
            raise InputError("--good and --not-good take neither CASE nor --out.", action="Give one or the other.")
        teach_good(good or [], not_good or [], keep, board, lambda: client_of(station, key_file, ca))
        return
    if case is None or out is None:
        raise InputError("a reference needs a recording and --out.", action="Give both, or good boards by --good.")
    from vaoi_station.stitching.recordings.references import teach as teach_reference

    stitch = teach_reference(
        case,
        calibration or case / "calibration.json",
        board or case / "board.json",
        out,
        confirm_orientation=confirm_orientation,
        rotation_deg=rotation,
    )
    typer.echo(f"{stitch.status}: standard deviation of positions {stitch.quality['cad_sigma_px']:.3f} px → {out}")


def report(
    run: CaseOf,
    out: Annotated[
        Path | None, typer.Option(help="Write the report to this file [report.html, unless --bundle].")
    ] = None,
    bundle: Annotated[
        Path | None, typer.Option(help="Create this directory with recording, documents, result, links and report.")
    ] = None,
    calibration: CalibrationOf = None,
    board: BoardOf = None,
    reference: ReferenceOf = None,
    method: Annotated[Evidence, typer.Option(help="Use this evidence.")] = "auto",
    rotation: RotationOf = None,
) -> None:
    """Stitch a recorded run and show the evidence in one HTML file."""
    from vaoi_station.files.directories import refuse_existing
    from vaoi_station.reporting import restitch, write_bundle, write_report
    from vaoi_station.reporting.report import REPORT, replay_command
    from vaoi_station.stitching.recordings.opening import open_run

    # The target is checked first, because stitching the run takes seconds.
    if bundle is not None:
        refuse_existing(bundle)
    opened = open_run(
        run, calibration=calibration, board=board, reference=reference, method=method, rotation_deg=rotation
    )
    stitched = restitch(opened)
    if bundle is not None:
        write_bundle(bundle, stitched)
        typer.echo(
            f"{stitched.result.status}: {bundle / REPORT}; to stitch it again: {replay_command(bundle, stitched)}"
        )
    if out is not None or bundle is None:
        path = out or Path("report.html")
        write_report(path, stitched)
        typer.echo(f"{stitched.result.status}: {path}")
    for reason in stitched.result.reasons:
        typer.echo(f"- {reason}")


def mosaic(
    case: CaseOf,
    result: ResultOf,
    out: Annotated[Path, typer.Option(help="Write the picture to this file, a tiled, pyramidal TIFF.")],
    calibration: CalibrationOf = None,
    board: BoardOf = None,
    px_per_mm: Annotated[
        float | None, typer.Option(min=0.1, max=1000, help="Resolution of the picture [that of the cameras].")
    ] = None,
    light: Annotated[str | None, typer.Option(help="Take only rows of this light [that of most rows].")] = None,
    exposure: Annotated[
        float | None, typer.Option(min=0, help="Take only frames of this exposure in µs [each camera's usual one].")
    ] = None,
    hdr: Annotated[bool, typer.Option("--hdr", help="Merge all exposures to linear radiance (32-bit float).")] = False,
    flatfield: FlatFieldOf = None,
    heights: Annotated[
        Path | None, typer.Option(help="With --hdr: take the heights of bodies from this file (of `vaoi heights`).")
    ] = None,
    region: Annotated[
        tuple[float, float, float, float] | None,
        typer.Option(help="Two opposite corners X0 Y0 X1 Y1 in CAD coordinates [the whole board]."),
    ] = None,
) -> None:
    """Write the whole board, or a region of it, as one picture (tiled, pyramidal TIFF)."""
    from vaoi_station.library.mosaic_file import MosaicOrder, write_board

    order = MosaicOrder(
        case,
        result,
        out,
        calibration=calibration,
        board=board,
        px_per_mm=px_per_mm,
        light=light,
        exposure_us=exposure,
        hdr=hdr,
        flatfield=flatfield,
        heights=heights,
        region=region,
    )
    for line in write_board(order):
        typer.echo(line)


def heights(
    case: CaseOf,
    result: ResultOf,
    out: Annotated[Path, typer.Option(help="Write the heights to this file (JSON).")],
    calibration: CalibrationOf = None,
    board: BoardOf = None,
    flatfield: FlatFieldOf = None,
    map: Annotated[
        tuple[float, float, float, float] | None,
        typer.Option(
            help="Write also a map of heights of the region X0 Y0 X1 Y1 in CAD coordinates, beside FILE: .map.tiff, "
            ".map-sigma.tiff, .map.png, .map.json."
        ),
    ] = None,
) -> None:
    """Measure how far every component stands above the board, from all frames that show it."""
    from vaoi_station.cli.opened_case import Case, refuse_input
    from vaoi_station.files.documents import write_json
    from vaoi_station.files.images import write_image
    from vaoi_station.heights.estimates import equalised_frames, heights_document, measure_heights, open_places
    from vaoi_station.heights.height_map import draw_map, measure_map
    from vaoi_station.photometry import FlatFields

    refuse_input(out, case, result, calibration, board)
    opened = Case.open(case, result, calibration, board)
    head, board_type, stitch, cameras = opened.recording.head, opened.board_type, opened.stitch, opened.cameras
    frame: Callable[[int, int], NDArray[Any] | None] = opened.recording.frame
    lights = head.lights or ()
    if flatfield is not None:
        fields = FlatFields.open(flatfield)
        fields.check_head(head)
        frame = equalised_frames(frame, fields, lights)
    # A region that is refused leaves no file.
    region = None if map is None else measure_map(open_places(board_type, stitch, cameras), map, frame, lights)
    found = measure_heights(board_type, stitch, cameras, frame, lights)
    write_json(out, heights_document(found, board_type))
    measured = sum(height.height_mm is not None for height in found.values())
    intervals = sum(bool(height.intervals) for height in found.values())
    typer.echo(f"{len(found)} component(s): {measured} height(s), {intervals} interval(s) → {out}")
    if region is not None:
        write_image(out.with_suffix(".map.tiff"), region.height_mm)
        write_image(out.with_suffix(".map-sigma.tiff"), region.sigma_mm)
        write_image(out.with_suffix(".map.png"), draw_map(region))
        head_of_map = {"image_from_cad": region.image_from_cad.tolist(), "px_per_mm": region.px_per_mm}
        write_json(out.with_suffix(".map.json"), head_of_map)
        h, w = region.height_mm.shape
        typer.echo(f"map of {w} × {h} places → {out.with_suffix('.map.tiff')}")


def identify(
    case: CaseOf,
    result: ResultOf,
    expect: Annotated[str | None, typer.Option(help="Compare the id that is read with this one.")] = None,
    out: Annotated[Path | None, typer.Option(help="Also write ids and codes to this file (JSON).")] = None,
    calibration: CalibrationOf = None,
    board: BoardOf = None,
) -> None:
    """Read the DataMatrix and QR codes of a board: at the places that its type states, or anywhere."""
    from vaoi_station.cli.opened_case import Case, refuse_input
    from vaoi_station.files.documents import write_json
    from vaoi_station.identity.code_reader import read_codes
    from vaoi_station.identity.comparison import compare
    from vaoi_station.model import BoardIdentity

    if out is not None:
        refuse_input(out, case, result, calibration, board)
    opened = Case.open(case, result, calibration, board)
    reading = read_codes(opened.board_type, opened.stitch, opened.cameras, opened.recording.frame)
    # Without `identity` in the board type, any code is taken for the board's.
    identity = opened.board_type.identity or BoardIdentity()
    found = compare(identity, reading, expect, skipped=opened.stitch.skipped_boards or ())
    mm = opened.board_type.unit
    for code in found.codes:
        x, y = code.center
        of = "" if code.panel is None else f" of position {code.panel}"
        typer.echo(
            f"{code.symbology}{of} {code.text!r} at ({x:.2f}, {y:.2f}) {mm}: modules of {code.module_mm:.3f} mm, "
            f"{100 * code.error_correction_used:.0f} % of the error correction used"
        )
    for reason in found.reasons:
        typer.echo(f"{reason.code}: {reason.message}")
    typer.echo(f"identity: {found.state}" + (f", board {found.board_id!r}" if found.board_id is not None else ""))
    if out is not None:
        write_json(out, found.model_dump(mode="json", exclude_none=True))


def check_board(
    case: CaseOf,
    result: ResultOf,
    board_type: Annotated[Path, typer.Option(help="Check this board type, for example one of `vaoi import`.")],
    out: Annotated[Path | None, typer.Option(help="Write the report to this file (JSON).")] = None,
    corrected: Annotated[Path | None, typer.Option(help="Write the corrected board type to this file.")] = None,
    revision: Annotated[
        str | None, typer.Option(help="Revision of the corrected board type [that of the data, with 'corrected'].")
    ] = None,
    picture: Annotated[
        Path | None, typer.Option(help="Write a picture of the bodies laid over the board to this file (.png, .jpg).")
    ] = None,
    calibration: CalibrationOf = None,
    board: Annotated[
        Path | None, typer.Option(help="The board type with which the run was stitched [CASE/board.json].")
    ] = None,
) -> None:
    """Lay a board type over a stitched run: shift, rotation, mirror, scale of its components, and the correction."""
    from vaoi_station.errors import StateError
    from vaoi_station.files import open_recording, read_board_type, read_calibration, read_stitch
    from vaoi_station.files.directories import refuse_existing
    from vaoi_station.files.documents import write_json
    from vaoi_station.files.images import write_image
    from vaoi_station.library.recordings import StitchedRun, check_result
    from vaoi_station.model import BoardType
    from vaoi_station.stitching.recordings.origin import check_origin

    for path in (out, corrected, picture):
        if path is not None:
            refuse_existing(path)
    recording = open_recording(case)
    known = read_calibration(calibration or case / "calibration.json", recording.head.cameras)
    cameras = known.cameras(recording.head.cameras)
    own_file = board or case / "board.json"
    own = read_board_type(own_file) if board is not None or own_file.is_file() else None
    stitch = read_stitch(result)
    check_result(stitch, recording.head.rows, cameras, result)
    check_origin(stitch, recording, known, own, result)
    checked = StitchedRun(recording, cameras, own, stitch).check_board_type(read_board_type(board_type))
    for line in _lines(checked.report):
        typer.echo(line)
    if out is not None:
        write_json(out, checked.report.model_dump(mode="json", exclude_none=True))
    if picture is not None:
        write_image(picture, checked.picture)
    if corrected is None:
        return
    if checked.corrected is None:
        raise StateError(
            f"{corrected}: is not written, because there is nothing to correct.", code="nothing-to-correct"
        )
    document = checked.corrected.model_dump(mode="json", exclude_none=True)
    document |= {} if revision is None else {"revision": revision}
    write_json(corrected, BoardType.model_validate(document).model_dump(mode="json", exclude_none=True))
    typer.echo(f"corrected ({', '.join(checked.report.moved)} moved) → {corrected}")


def _lines(report: BoardCheck) -> list[str]:
    lines = []
    r = report.residual
    if r is not None:
        (x, y), (sx, sy) = r.shift_mm, r.shift_sigma_mm
        mirrored = ", mirrored" if r.mirrored else ""
        lines.append(
            f"{report.board_type}: shift ({x:.3f} ± {sx:.3f}, {y:.3f} ± {sy:.3f}) mm, rotation {r.rotation_deg:.3f} ± "
            f"{r.rotation_sigma_deg:.3f}°, scale {r.scale:.5f} ± {r.scale_sigma:.5f}{mirrored}"
        )
    lines += [f"check: {warning.message}" for warning in report.warnings]
    if not report.warnings:
        lines.append("nothing to correct")
    return lines
