"""With what runs are stitched again."""

from __future__ import annotations

from dataclasses import dataclass
from hashlib import sha256
from typing import Any

from vaoi_station.stitching.matching.evidence import MethodName


@dataclass(frozen=True)
class Terms:
    """With what runs are stitched; None: with what the archive has for each run."""

    software: str
    calibration: bytes | None = None
    """Content of a calibration.json."""
    board_type: bytes | None = None
    """Content of a board.json."""
    method: MethodName | None = None

    def document(self) -> dict[str, Any]:
        """Return what identifies the terms, as a JSON object."""
        digests = {"calibration": self.calibration, "board_type": self.board_type}
        return {
            "software": self.software,
            "method": self.method,
            **{name: content and sha256(content).hexdigest() for name, content in digests.items()},
        }
