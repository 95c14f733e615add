"""What differs between the former and the new results of a data set.

DuckDB reads the Parquet files, so that neither the number of runs nor that of components is limited by memory.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    import duckdb

MOST_LISTED = 200
"""Number of boards and of components that are listed, those that changed most first."""


class BoardChange(NamedTuple):
    """One run: its verdicts, and how far its components moved in the frames."""

    station: str
    run: str
    board_type: str
    board_id: str | None
    former: str
    new: str
    views: int
    """Number of positions that both results state."""
    changed: int
    """Number of those that moved by more than their σ."""
    rms_px: float | None
    worst_px: float | None
    worst_sigmas: float | None
    """The largest motion, in σ of the position."""


class CameraChange(NamedTuple):
    """One camera of a station, as the mean of all runs."""

    station: str
    camera: int
    runs: int
    changed: int
    """Number of runs in which its estimated displacement changed by more than its σ."""
    x_px: float
    """Change of the estimated displacement against that of the station's other cameras, x."""
    y_px: float
    turn_px: float
    size_px: float
    """Length of (x_px, y_px)."""
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
    """Number of runs in which one of its positions moved by more than its σ."""
    rms_px: float
    worst_sigmas: float | None
    x_mm: float | None
    """Mean change of its place, tester coordinates."""
    y_mm: float | None
    height_mm: float | None
    """Mean change of its height."""


@dataclass(frozen=True)
class Changes:
    """The comparison of all runs of a data set."""

    runs: int
    """Number of runs with both results."""
    only_new: int
    """Number of runs without a former result."""
    verdicts: tuple[tuple[str, str, int], ...]
    """Former and new verdict, and the number of runs."""
    views: int
    changed_views: int
    changed_boards: int
    """Number of runs in which a position moved by more than its σ, or whose verdict changed."""
    changed_components: int
    """Number of components of which a position moved by more than its σ in any run."""
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
