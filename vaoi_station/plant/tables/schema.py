"""The columns of the tables. `docs/plant.md` lists them; a test compares both."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal, NamedTuple

if TYPE_CHECKING:
    import pyarrow as pa

Kind = Literal["text", "texts", "time", "whole", "real"]


class Column(NamedTuple):
    """One column: its name, the kind of its values, and their meaning."""

    name: str
    kind: Kind
    meaning: str


_KEY = (
    Column("station", "text", "station that filmed the run"),
    Column("run", "text", "id of the run"),
    Column("time", "time", "begin of the run, UTC"),
    Column("board_type", "text", "name of the board type"),
    Column("result", "text", "`former`: the station's result; `new`: that of `vaoi restitch`"),
)
"""Columns that every table has: they join the tables, and select without a join."""

TABLES: dict[str, tuple[Column, ...]] = {
    "runs": (
        *_KEY,
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
        *_KEY,
        Column("row", "whole", "row, from 0"),
        Column("x_mm", "real", "displacement of the board's pivot since row 0, x"),
        Column("y_mm", "real", "the same, y"),
        Column("turn_mrad", "real", "rotation of the board since row 0"),
        Column("sigma_px", "real", "σ of the positions in the row"),
    ),
    "cameras": (
        *_KEY,
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
        *_KEY,
        Column("camera", "whole", "one camera of the overlap"),
        Column("other_camera", "whole", "the other one"),
        Column("residual_px", "real", "median residual of the links between both"),
    ),
    "fiducials": (
        *_KEY,
        Column("name", "text", "name of the fiducial"),
        Column("sightings", "whole", "number of frames in which it was detected"),
        Column("x_px", "real", "residual, x; null: the fiducial was not used"),
        Column("y_px", "real", "the same, y"),
    ),
    "components": (
        *_KEY,
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
        *_KEY,
        Column("component", "text", "address of the component"),
        Column("camera", "whole", "camera of the frame"),
        Column("row", "whole", "row of the frame"),
        Column("x_px", "real", "position of the component's centre in the frame, undistorted pixels"),
        Column("y_px", "real", "the same, y"),
        Column("sigma_px", "real", "σ of this position in the direction in which it is largest"),
    ),
}
"""Columns by table."""


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
