"""What differs between the former and the new results of a data set, by DuckDB, and as one HTML file."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from vaoi_station.reporting.drawing import Section, facts, number, page, table, tag, text

if TYPE_CHECKING:
    import duckdb

MOST_LISTED = 200


class BoardChange(NamedTuple):
    """One run: its verdicts, and how far its components moved in the frames."""

    station: str
    run: str
    board_type: str
    board_id: str | None
    former: str
    new: str
    views: int
    changed: int
    rms_px: float | None
    worst_px: float | None
    worst_sigmas: float | None


class CameraChange(NamedTuple):
    """One camera of a station, as the mean of all runs."""

    station: str
    camera: int
    runs: int
    changed: int
    x_px: float
    """Change of the estimated displacement against that of the station's other cameras, x."""
    y_px: float
    turn_px: float
    size_px: float
    sigma_px: float | None
    """σ of the displacement in one run, rms of x and y."""
    view_px: float | None
    """Motion on the board of what the camera sees in the middle of its frame: what the estimate has not undone,
    against the other cameras."""

    @property
    def sigmas(self) -> float | None:
        """The size in standard deviations; None if σ is not known or 0."""
        return self.size_px / self.sigma_px if self.sigma_px else None


class ComponentChange(NamedTuple):
    """One component of a board type, over all runs."""

    board_type: str
    component: str
    runs: int
    changed: int
    rms_px: float
    worst_sigmas: float | None
    x_mm: float | None
    y_mm: float | None
    height_mm: float | None


@dataclass(frozen=True)
class Changes:
    """The comparison of all runs of a data set."""

    runs: int
    only_new: int
    """Number of runs without a former result."""
    verdicts: tuple[tuple[str, str, int], ...]
    views: int
    changed_views: int
    changed_boards: int
    """Number of runs in which a position moved by more than its σ, or whose verdict changed."""
    changed_components: int
    boards: tuple[BoardChange, ...]
    cameras: tuple[CameraChange, ...]
    components: tuple[ComponentChange, ...]


def compare(tables: Path) -> Changes:
    """Compare the former with the new results of a data set that `write_tables` wrote."""
    import duckdb

    with duckdb.connect() as database:
        for name in ("runs", "cameras", "components", "views"):
            files = str(tables / name / "*.parquet").replace("'", "''")
            database.execute(f"CREATE VIEW {name} AS SELECT * FROM read_parquet('{files}')")
        database.execute(_PAIRS)
        runs, only_new = _row(database, "SELECT count(former), count(*) - count(former) FROM verdicts")
        views, changed = _row(database, "SELECT count(*), coalesce(sum(moved::INT), 0) FROM motions")
        boards = _row(database, f"SELECT count(*) FROM ({_BOARDS}) WHERE changed > 0 OR former <> new")[0]
        parts = _row(database, f"SELECT count(*) FROM ({_COMPONENTS}) WHERE changed > 0")[0]
        return Changes(
            runs=runs,
            only_new=only_new,
            verdicts=tuple(database.execute(_VERDICTS).fetchall()),
            views=views,
            changed_views=int(changed),
            changed_boards=boards,
            changed_components=parts,
            boards=tuple(BoardChange(*row) for row in database.execute(_BOARDS + _FIRST, [MOST_LISTED]).fetchall()),
            cameras=tuple(CameraChange(*row) for row in database.execute(_CAMERAS).fetchall()),
            components=tuple(
                ComponentChange(*row) for row in database.execute(_COMPONENTS + _FIRST, [MOST_LISTED]).fetchall()
            ),
        )


def _row(database: duckdb.DuckDBPyConnection, query: str) -> tuple[Any, ...]:
    row = database.execute(query).fetchone()
    assert row is not None  # aggregates of no rows are one row
    return row


# σ is that of the larger of both results: a position that has become less certain has not moved by that alone.
_PAIRS = """
CREATE MACRO hypot(a, b) AS sqrt(a * a + b * b);

CREATE VIEW verdicts AS
SELECT n.station, n.run, n.board_type, n.board_id, f.status AS former, n.status AS new
FROM (SELECT * FROM runs WHERE result = 'new') n
LEFT JOIN (SELECT * FROM runs WHERE result = 'former') f USING (station, run);

CREATE VIEW motions AS
SELECT n.station, n.run, n.board_type, n.component, n.camera,
       hypot(n.x_px - f.x_px, n.y_px - f.y_px) AS px,
       greatest(n.sigma_px, f.sigma_px) AS sigma,
       coalesce(px > sigma, false) AS moved
FROM (SELECT * FROM views WHERE result = 'new') n
JOIN (SELECT * FROM views WHERE result = 'former') f USING (station, run, component, camera, "row");

CREATE VIEW estimates AS
SELECT n.station, n.run, n.camera,
       n.x_px - f.x_px AS x, n.y_px - f.y_px AS y, n.turn_px - f.turn_px AS turn,
       sqrt((pow(greatest(n.sigma_x_px, f.sigma_x_px), 2) + pow(greatest(n.sigma_y_px, f.sigma_y_px), 2)) / 2) AS sigma,
       (n.center_x_mm - f.center_x_mm) * n.px_per_mm AS view_x, (n.center_y_mm - f.center_y_mm) * n.px_per_mm AS view_y
FROM (SELECT * FROM cameras WHERE result = 'new') n
JOIN (SELECT * FROM cameras WHERE result = 'former') f USING (station, run, camera);

-- A motion of all cameras together does not show in a run, so each is compared with the mean of the others.
CREATE VIEW displacements AS
SELECT a.station, a.run, a.camera, any_value(a.sigma) AS sigma,
       any_value(a.view_x) - coalesce(median(b.view_x), 0) AS view_x,
       any_value(a.view_y) - coalesce(median(b.view_y), 0) AS view_y,
       any_value(a.x) - coalesce(median(b.x), 0) AS x,
       any_value(a.y) - coalesce(median(b.y), 0) AS y,
       any_value(a.turn) - coalesce(median(b.turn), 0) AS turn
FROM estimates a
LEFT JOIN estimates b ON a.station = b.station AND a.run = b.run AND a.camera <> b.camera
WHERE a.x IS NOT NULL
GROUP BY a.station, a.run, a.camera;
"""

_VERDICTS = """
SELECT former, new, count(*) FROM verdicts WHERE former IS NOT NULL GROUP BY ALL ORDER BY ALL
"""

_BOARDS = """
SELECT station, run, any_value(v.board_type), any_value(board_id), any_value(former) AS former, any_value(new) AS new,
       count(px), coalesce(sum(moved::INT), 0)::BIGINT AS changed,
       sqrt(avg(px * px)) AS rms, max(px), max(px / nullif(sigma, 0)) AS sigmas
FROM verdicts v LEFT JOIN motions m USING (station, run)
WHERE former IS NOT NULL
GROUP BY station, run
"""

_CAMERAS = """
SELECT station, camera, count(*), count(*) FILTER (hypot(x, y) > sigma), avg(x), avg(y), avg(turn),
       hypot(avg(x), avg(y)) AS size, sqrt(avg(sigma * sigma)), hypot(avg(view_x), avg(view_y)) AS view
FROM displacements GROUP BY station, camera
ORDER BY greatest(size, coalesce(view, 0)) DESC, station, camera
"""

_COMPONENTS = """
SELECT m.board_type, m.component, count(DISTINCT (m.station, m.run)),
       count(DISTINCT (m.station, m.run)) FILTER (m.moved) AS changed,
       sqrt(avg(m.px * m.px)) AS rms, max(m.px / nullif(m.sigma, 0)) AS sigmas,
       any_value(p.x), any_value(p.y), any_value(p.height)
FROM motions m
LEFT JOIN (
    SELECT n.board_type, n.component, avg(n.x_mm - f.x_mm) AS x, avg(n.y_mm - f.y_mm) AS y,
           avg(n.height_mm - f.height_mm) AS height
    FROM (SELECT * FROM components WHERE result = 'new') n
    JOIN (SELECT * FROM components WHERE result = 'former') f USING (station, run, component)
    GROUP BY n.board_type, n.component
) p USING (board_type, component)
GROUP BY m.board_type, m.component
"""

_FIRST = " ORDER BY changed DESC, sigmas DESC NULLS LAST, 1, 2 LIMIT ?"


def render_changes(
    changes: Changes, terms: list[tuple[str, str]], left_out: list[str], unequal: Sequence[str] = ()
) -> str:
    """Return the comparison as an HTML document; `terms` are name and value of all that the runs were stitched with."""
    sections = [_numbers(changes, terms), _listed("left-out", "Left out", "", left_out)]
    if unequal:
        lead = "These runs may have changed because their archive does not have all that their stations used."
        sections.append(_listed("unequal", "Stitched otherwise than by the station", lead, unequal))
    sections += [_cameras(changes), _boards(changes), _parts(changes)]
    # "</script>" inside a text would end the element; an escaped "<" cannot.
    content = json.dumps(asdict(changes), allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
    data = tag("script", content, type="application/json", id="changes")
    return page("Runs stitched again", _head(changes, left_out), sections, data)


def _head(changes: Changes, left_out: list[str]) -> str:
    words = f"{changes.changed_boards} of {changes.runs} runs changed" if changes.runs else "nothing to compare"
    style = "failed" if left_out else "degraded" if changes.changed_boards else "ok"
    heading = tag("h1", "Runs stitched again", tag("span", text(words), class_="verdict"))
    return tag("header", heading, tag("p", text("changed: by more than its σ, or in its verdict")), class_=style)


def _numbers(changes: Changes, terms: list[tuple[str, str]]) -> Section:
    verdicts = [(f"{former} → {new}", str(count)) for former, new, count in changes.verdicts]
    counts = [
        ("runs with both results", str(changes.runs)),
        ("runs without a former result", str(changes.only_new)),
        ("positions compared", str(changes.views)),
        ("positions changed", f"{changes.changed_views} ({_share(changes.changed_views, changes.views)})"),
        ("components changed", str(changes.changed_components)),
    ]
    columns = tag("div", facts([*counts, *verdicts]), facts(terms), class_="columns")
    return Section("numbers", "Key numbers", "A verdict stands as former → new, with its number of runs.", columns)


def _listed(name: str, title: str, lead: str, lines: Sequence[str]) -> Section:
    body = tag("ul", *(tag("li", text(line)) for line in lines)) if lines else tag("p", "Nothing.", class_="none")
    return Section(name, title, lead, body)


def _cameras(changes: Changes) -> Section:
    rows = [
        [
            c.station,
            str(c.camera),
            f"{c.changed} of {c.runs}",
            *map(number, (c.size_px, c.x_px, c.y_px, c.turn_px, c.sigma_px)),
            number(c.sigmas, 1),
            number(c.view_px),
        ]
        for c in changes.cameras
    ]
    lead = (
        "Change of the displacement that the runs show of each camera, against the median of the station's other "
        "cameras: its length, its parts, its σ in one run, and both in relation. “View” is the motion on the board of "
        "what the camera sees in the middle of its frame. A calibration that is wrong by a displacement shows it in "
        "the first, if the runs correct it; what they do not show stays in the second. The largest change comes first."
    )
    columns = ["station", "camera", "runs changed", "size px", "x px", "y px", "turn px", "σ px", "σ", "view px"]
    return Section("cameras", "Cameras", lead, table(columns, rows, 2) if rows else _none())


def _boards(changes: Changes) -> Section:
    rows = [
        [
            b.station,
            b.run,
            b.board_type,
            b.board_id or "–",
            b.new if b.former == b.new else f"{b.former} → {b.new}",
            f"{b.changed} of {b.views}",
            number(b.rms_px),
            number(b.worst_px),
            number(b.worst_sigmas, 1),
        ]
        for b in changes.boards
    ]
    lead = (
        "Motion of the positions of all components in all frames of a run. At most "
        f"{MOST_LISTED} runs are listed, those with the most changes first; the data set has all."
    )
    columns = ["station", "run", "board type", "board", "verdict", "changed", "rms px", "largest px", "largest σ"]
    return Section("boards", "Boards", lead, table(columns, rows, 5) if rows else _none())


def _parts(changes: Changes) -> Section:
    rows = [
        [
            c.board_type,
            c.component,
            f"{c.changed} of {c.runs}",
            number(c.rms_px),
            number(c.worst_sigmas, 1),
            number(c.x_mm, 4),
            number(c.y_mm, 4),
            number(c.height_mm, 3),
        ]
        for c in changes.components
    ]
    lead = (
        "Motion of a component in the frames, and the mean change of its place and height, over all runs of its board "
        f"type. At most {MOST_LISTED} are listed."
    )
    columns = ["board type", "component", "runs changed", "rms px", "largest σ", "x mm", "y mm", "height mm"]
    return Section("components", "Components", lead, table(columns, rows, 2) if rows else _none())


def _none() -> str:
    return tag("p", "No run has both results.", class_="none")


def _share(part: int, whole: int) -> str:
    return f"{part / whole:.1%}" if whole else "–"
