"""Calibration checks: one small document per run, grouped by the calibration the run was stitched with."""

from __future__ import annotations

import sqlite3
from concurrent.futures import Future

from vaoi_station.store.database import Database
from vaoi_station.store.standing import StandingDocuments

FIRST_KEPT, LATEST_KEPT = 100, 2000
"""Numbers of checks kept per calibration: the first ones after the calibration came into force, and the latest ones."""
_BASELINES = "lamp-baselines"


class CalibrationChecks:
    """Storage of the calibration checks of one station."""

    def __init__(self, database: Database) -> None:
        self._database, self._standing = database, StandingDocuments(database)

    def save(self, run: str, calibration_digest: str, document: str) -> Future[None]:
        """Save the check of a run. Delete checks of its calibration that are neither among the first nor the latest."""

        def write(connection: sqlite3.Connection) -> None:
            connection.execute(
                "INSERT OR REPLACE INTO calibration_checks VALUES (?, ?, ?)", (run, calibration_digest, document)
            )
            # Run ids sort by time, so ORDER BY run is the order in which boards passed.
            connection.execute(
                """DELETE FROM calibration_checks WHERE calibration_digest = ?1
                   AND run IN (SELECT run FROM calibration_checks WHERE calibration_digest = ?1
                               ORDER BY run DESC LIMIT -1 OFFSET ?2)
                   AND run NOT IN (SELECT run FROM calibration_checks WHERE calibration_digest = ?1
                                   ORDER BY run LIMIT ?3)""",
                (calibration_digest, LATEST_KEPT, FIRST_KEPT),
            )

        return self._database.write(write, patient=True, durable=False, size=len(document))

    def documents(self, calibration_digest: str, first: int, latest: int) -> list[str]:
        """Return the `first` oldest and `latest` newest checks of a calibration, oldest first, without duplicates."""
        rows = self._database.read(
            """SELECT run, document FROM calibration_checks WHERE calibration_digest = ?1 AND (
                   run IN (SELECT run FROM calibration_checks WHERE calibration_digest = ?1 ORDER BY run LIMIT ?2)
                OR run IN (SELECT run FROM calibration_checks WHERE calibration_digest = ?1
                           ORDER BY run DESC LIMIT ?3)) ORDER BY run""",
            (calibration_digest, first, latest),
        )
        return [str(row["document"]) for row in rows]

    def count(self, calibration_digest: str) -> int:
        """Return the number of checks kept for a calibration."""
        rows = self._database.read(
            "SELECT count(*) AS n FROM calibration_checks WHERE calibration_digest = ?", (calibration_digest,)
        )
        return int(rows[0]["n"])

    def baselines(self) -> str | None:
        """Return the document of all board types' brightness that was saved last; None if there is none."""
        return self._standing.get(_BASELINES)

    def save_baselines(self, document: str) -> Future[None]:
        """Save the brightness of all board types in one document, whether or not the checks that it is of are kept."""
        return self._standing.set(_BASELINES, document)
