"""Results as tables: one Parquet data set of runs, rows, cameras, seams, fiducials, components and views."""

from __future__ import annotations

import math
import shutil
from collections.abc import Iterable, Iterator, Mapping, Sequence
from glob import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np

from vaoi_station.files.directories import new_directory, remove_directory
from vaoi_station.geometry import apply
from vaoi_station.model import BoardType, RecordingHead, Stitch

if TYPE_CHECKING:
    import pyarrow as pa

Kind = Literal["text", "texts", "time", "whole", "real"]


class Column(NamedTuple):
    """One column: its name, the kind of its values, and their meaning."""

    name: str
    kind: Kind
    meaning: str


KEY = (
    Column("station", "text", "station that filmed the run"),
    Column("run", "text", "id of the run"),
    Column("time", "time", "begin of the run, UTC"),
    Column("board_type", "text", "name of the board type"),
    Column("result", "text", "`former`: the station's result; `new`: that of `vaoi restitch`"),
)
"""Columns that every table has: they join the tables, and select without a join."""

TABLES: dict[str, tuple[Column, ...]] = {
    "runs": (
        *KEY,
        Column("board_id", "text", "id of the board, if the station knew it"),
        Column("status", "text", "verdict: `ok`, `degraded` or `failed`"),
        Column("reason_codes", "texts", "codes of the reasons of the verdict"),
        Column("method", "text", "method of stitching"),
        Column("software", "text", "software that made the result"),
        Column("cameras", "whole", "number of cameras"),
        Column("rows", "whole", "number of rows"),
        Column("link_median_px", "real", "median residual of the links"),
        Column("link_scatter_px", "real", "noise floor of the links"),
        Column("sigma0", "real", "σ₀ of the adjustment; 1: as predicted"),
        Column("cad_sigma_px", "real", "σ of positions, worst corner of the board"),
        Column("scale_error", "real", "scale of the pictures against CAD, minus 1"),
        Column("speed_mm_s", "real", "measured speed of the belt"),
    ),
    "rows": (
        *KEY,
        Column("row", "whole", "row, from 0"),
        Column("x_mm", "real", "displacement of the board's pivot since row 0, x"),
        Column("y_mm", "real", "the same, y"),
        Column("turn_mrad", "real", "rotation of the board since row 0"),
        Column("sigma_px", "real", "σ of the positions in the row"),
    ),
    "cameras": (
        *KEY,
        Column("camera", "whole", "camera, from 0"),
        Column("x_px", "real", "estimated displacement since the calibration, x, in the middle of the frame"),
        Column("y_px", "real", "the same, y"),
        Column("turn_px", "real", "the same by a turn, at the corner of the frame"),
        Column("sigma_x_px", "real", "σ of x_px"),
        Column("sigma_y_px", "real", "σ of y_px"),
        Column("sigma_turn_px", "real", "σ of turn_px"),
        Column("center_x_mm", "real", "row coordinates of the middle of the frame, x, with the displacement"),
        Column("center_y_mm", "real", "the same, y"),
        Column("px_per_mm", "real", "resolution in the middle of the frame"),
    ),
    "seams": (
        *KEY,
        Column("camera", "whole", "one camera of the overlap"),
        Column("other_camera", "whole", "the other one"),
        Column("residual_px", "real", "median residual of the links between both"),
    ),
    "fiducials": (
        *KEY,
        Column("name", "text", "name of the fiducial"),
        Column("sightings", "whole", "number of frames in which it was detected"),
        Column("x_px", "real", "residual, x; null: the fiducial was not used"),
        Column("y_px", "real", "the same, y"),
    ),
    "components": (
        *KEY,
        Column("component", "text", "address: reference, on a panel `panel/reference`"),
        Column("package", "text", "package, as the board type names it"),
        Column("x_mm", "real", "place of the centre, tester coordinates: C of the CAD place, not measured in pictures"),
        Column("y_mm", "real", "the same, y"),
        Column("sigma_px", "real", "σ of its position, worst view"),
        Column("links", "whole", "number of links between two frames that both show the centre"),
        Column("residual_px", "real", "rms of the residuals of these links; null: there are none"),
        Column("local_x_mm", "real", "displacement against C by its local fiducials, x; null: it follows C"),
        Column("local_y_mm", "real", "the same, y"),
        Column("height_mm", "real", "height above the board"),
        Column("height_sigma_mm", "real", "σ of the height"),
        Column("views", "whole", "number of frames in which its centre lies"),
        Column("coverage", "real", "share of the footprint that frames show, if it is too little; else null"),
        Column("status", "text", "verdict of the run"),
    ),
    "views": (
        *KEY,
        Column("component", "text", "address of the component"),
        Column("camera", "whole", "camera of the frame"),
        Column("row", "whole", "row of the frame"),
        Column("x_px", "real", "position of the component's centre in the frame, undistorted pixels"),
        Column("y_px", "real", "the same, y"),
        Column("sigma_px", "real", "σ of this position in the direction in which it is largest"),
    ),
}


def arrow_schema(table: str) -> pa.Schema:
    """Return the schema of a table, with the meaning of each column in the metadata of its field."""
    import pyarrow as pa

    kinds = {
        "text": pa.string(),
        "texts": pa.list_(pa.string()),
        "time": pa.timestamp("us", tz="UTC"),
        "whole": pa.int32(),
        "real": pa.float64(),
    }
    return pa.schema([pa.field(c.name, kinds[c.kind], metadata={"meaning": c.meaning}) for c in TABLES[table]])


ResultName = Literal["former", "new"]
Tables = dict[str, dict[str, list[Any]]]
"""By table and column: the values of all rows. All columns of a table have the same length."""


class RunKey(NamedTuple):
    """What identifies a run in every table, and the board that it showed."""

    station: str
    run: str
    time: str
    board_type: str
    board_id: str | None = None


def result_tables(
    key: RunKey, name: ResultName, result: Stitch, board_type: BoardType | None, head: RecordingHead
) -> Tables:
    """Return the rows that a result adds to each table.

    Figures that a result of an older version does not state, or states in another form, are None.
    """
    common = {"station": key.station, "run": key.run, "time": key.time, "board_type": key.board_type, "result": name}
    found: dict[str, Iterable[dict[str, Any]]] = {
        "runs": [_run(key, result)],
        "rows": _rows(result),
        "cameras": _cameras(result, head),
        "seams": _seams(result),
        "fiducials": _fiducials(result),
        "components": _components(result, board_type),
        "views": _views(result),
    }
    rows = {table: [common | row for row in found[table]] for table in TABLES}
    return {table: {c.name: [row[c.name] for row in rows[table]] for c in columns} for table, columns in TABLES.items()}


def _run(key: RunKey, result: Stitch) -> dict[str, Any]:
    q = result.quality
    residual, belt = _mapping(q.get("residual_px")), _mapping(q.get("belt"))
    speed = _numbers(belt.get("measured_mm_s"), 2)
    return {
        "board_id": key.board_id,
        "status": str(result.status),
        "reason_codes": list(result.reason_codes),
        "method": result.method,
        "software": software if isinstance(software := q.get("software"), str) else None,
        "cameras": len(result.image_matrices),
        "rows": len(result.row_motion),
        "link_median_px": _number(residual.get("median")),
        "link_scatter_px": _number(residual.get("scatter")),
        "sigma0": _number(residual.get("sigma0")),
        "cad_sigma_px": _number(q.get("cad_sigma_px")),
        "scale_error": _number(q.get("scale_error")),
        "speed_mm_s": None if speed[0] is None or speed[1] is None else math.hypot(speed[0], speed[1]),
    }


def _rows(result: Stitch) -> Iterator[dict[str, Any]]:
    pivot = _numbers(result.quality.get("pivot_mm"), 2)
    # About another point than the pivot, the errors of rotation and displacement of a row would be correlated.
    about = np.array([0.0 if v is None else v for v in pivot])
    sigma = _numbers(result.quality.get("row_sigma_px"), len(result.row_motion))
    for row, matrix in enumerate(result.row_motion):
        x, y = (apply(np.asarray(matrix), about[None])[0] - about).tolist()
        turn = 1e3 * math.atan2(matrix[1][0], matrix[0][0])
        yield {"row": row, "x_mm": x, "y_mm": y, "turn_mrad": turn, "sigma_px": sigma[row]}


def _cameras(result: Stitch, head: RecordingHead) -> Iterator[dict[str, Any]]:
    count = len(head.cameras)
    moved = _sequence(result.quality.get("camera_displacement_px"), count)
    sigma = _sequence(result.quality.get("camera_displacement_sigma_px"), count)
    for i, camera in enumerate(head.cameras):
        x, y, turn = _numbers(moved[i], 3)
        sigma_x, sigma_y, sigma_turn = _numbers(sigma[i], 3)
        out = {"camera": i, "x_px": x, "y_px": y, "turn_px": turn}
        out |= {"sigma_x_px": sigma_x, "sigma_y_px": sigma_y, "sigma_turn_px": sigma_turn}
        center_mm: list[Any] = [None, None]
        px_per_mm = None
        if result.camera_matrices is not None and i < len(result.camera_matrices):
            row_from_image = np.linalg.inv(np.asarray(result.camera_matrices[i]))
            middle = np.array([(camera.width - 1) / 2, (camera.height - 1) / 2])
            # The middle, and the pixels beside it, whose distances are the size of a pixel.
            near = apply(row_from_image, middle + np.array([[0, 0], [1, 0], [0, 1]]))
            center_mm = near[0].tolist()
            edges = near[1:] - near[0]
            px_per_mm = 1 / math.sqrt(abs(float(edges[0, 0] * edges[1, 1] - edges[0, 1] * edges[1, 0])))
        yield out | {"center_x_mm": center_mm[0], "center_y_mm": center_mm[1], "px_per_mm": px_per_mm}


def _seams(result: Stitch) -> Iterator[dict[str, Any]]:
    for pair, residual in _mapping(result.quality.get("seams_px")).items():
        first, _, second = str(pair).partition("-")
        if first.isdecimal() and second.isdecimal():
            yield {"camera": int(first), "other_camera": int(second), "residual_px": _number(residual)}


def _fiducials(result: Stitch) -> Iterator[dict[str, Any]]:
    found = result.quality.get("fiducials")
    for entry in found if isinstance(found, list) else []:
        mark = _mapping(entry)
        x, y = _numbers(mark.get("residual_px"), 2)
        count = _number(mark.get("sightings"))
        yield {
            "name": str(mark.get("name")),
            "sightings": None if count is None else int(count),
            "x_px": x,
            "y_px": y,
        }


def _components(result: Stitch, board_type: BoardType | None) -> Iterator[dict[str, Any]]:
    q = result.quality
    sigma, height, height_sigma, unseen = (
        _mapping(q.get(name)) for name in ("component_sigma_px", "heights_mm", "height_sigma_mm", "unseen")
    )
    views, links = result.components or {}, _links(result)
    local = _mapping(q.get("local_fiducials"))
    for part in board_type.components if board_type else ():
        address = part.address
        matrix = result.component_matrix(address)
        place = [None, None] if matrix is None else apply(np.asarray(matrix), np.array([part.center]))[0].tolist()
        frames = {(camera, row) for camera, row, _, _ in views.get(address, ())}
        shown = [(used, rms) for pair, used, rms in links if pair <= frames]
        count = sum(used for used, _ in shown)
        placed = _mapping(local.get(address))
        local_mm = _numbers(placed.get("shift_mm") if placed.get("refusal") is None else None, 2)
        yield {
            "component": address,
            "package": part.package,
            "x_mm": place[0],
            "y_mm": place[1],
            "sigma_px": _number(sigma.get(address)),
            "links": count,
            "residual_px": math.sqrt(sum(used * rms**2 for used, rms in shown) / count) if count else None,
            "local_x_mm": local_mm[0],
            "local_y_mm": local_mm[1],
            "height_mm": _number(height.get(address)),
            "height_sigma_mm": _number(height_sigma.get(address)),
            "views": len(views.get(address, ())),
            "coverage": _number(_mapping(unseen.get(address)).get("coverage")),
            "status": str(result.status),
        }


def _links(result: Stitch) -> list[tuple[set[tuple[int, int]], int, float]]:
    """Return pairs of linked frames (camera, row), the number of their used links, and the rms of the residuals."""
    pairs = result.quality.get("link_pairs")
    found = []
    for entry in pairs if isinstance(pairs, list) else []:
        pair = _mapping(entry)
        one, other = _numbers(pair.get("a"), 2), _numbers(pair.get("b"), 2)
        used, rms = _number(pair.get("used")), _number(pair.get("rms_px"))
        # A frame that is linked with itself has links with the reference or with marks, not with another frame.
        if one != other and None not in (*one, *other) and used and rms is not None:
            found.append(({(int(c), int(r)) for c, r in (one, other)}, int(used), rms))  # type: ignore[arg-type]
    return found


def _views(result: Stitch) -> Iterator[dict[str, Any]]:
    covariances = _mapping(result.quality.get("component_covariance_px2"))
    for address, views in (result.components or {}).items():
        stated = covariances.get(address)
        entries = [_numbers(entry, 5) for entry in (stated if isinstance(stated, list) else [])]
        sigma = {(c, r): _largest_sigma(xx, xy, yy) for c, r, xx, xy, yy in entries}
        for camera, row, x, y in views:
            at = {"component": address, "camera": camera, "row": row, "x_px": x, "y_px": y}
            yield at | {"sigma_px": sigma.get((camera, row))}


def _largest_sigma(xx: float | None, xy: float | None, yy: float | None) -> float | None:
    if xx is None or xy is None or yy is None:
        return None
    return math.sqrt(max((xx + yy) / 2 + math.hypot((xx - yy) / 2, xy), 0.0))


def _number(value: Any) -> float | None:
    usable = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
    return float(value) if usable else None


def _mapping(value: Any) -> Mapping[str, Any]:
    return value if isinstance(value, dict) else {}


def _sequence(value: Any, length: int) -> Sequence[Any]:
    return value if isinstance(value, list | tuple) and len(value) == length else [None] * length


def _numbers(value: Any, length: int) -> list[float | None]:
    return [_number(v) for v in _sequence(value, length)]


MOST_ROWS = 500_000
"""Number of rows of all tables together from which a part is written: it bounds the memory of the writer."""


def write_tables(directory: Path, runs: Iterable[Tables], most_rows: int = MOST_ROWS) -> None:
    """Write the tables of runs to `directory/TABLE/part-NNNNN.parquet`, and replace an older data set.

    Equal runs in equal order give equal bytes. The tables of all runs are never in memory together.
    """
    draft_of = directory.with_name(f".{directory.name}.new")
    for left in (draft_of, *directory.parent.glob(f".{escape(draft_of.name)}.*")):
        shutil.rmtree(left, ignore_errors=True)  # of a call that was killed
    with new_directory(draft_of) as draft:
        for table in TABLES:
            (draft / table).mkdir()
        part, rows = 0, _empty()
        for tables in runs:
            for table, columns in tables.items():
                for column, values in columns.items():
                    rows[table][column] += values
            if sum(len(rows[table]["run"]) for table in TABLES) >= most_rows:
                _write_part(draft, part, rows)
                part, rows = part + 1, _empty()
        # The first part is written even without rows: readers find every table, with its columns.
        if part == 0 or rows["runs"]["run"]:
            _write_part(draft, part, rows)
    if directory.exists():
        remove_directory(directory)
    draft_of.rename(directory)


def _empty() -> Tables:
    return {table: {column.name: [] for column in columns} for table, columns in TABLES.items()}


def _write_part(directory: Path, part: int, rows: Tables) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    for table in TABLES:
        columns = {name: _times(values) if name == "time" else values for name, values in rows[table].items()}
        path = directory / table / f"part-{part:05d}.parquet"
        pq.write_table(pa.table(columns, schema=arrow_schema(table)), path, compression="zstd")


def _times(values: list[Any]) -> list[Any]:
    """Convert RFC 3339 texts; rows of one run have equal ones."""
    from datetime import datetime

    known = {text: datetime.fromisoformat(text) for text in set(values)}
    return [known[text] for text in values]
