"""hw/protocol_vectors.json, and what our own controller says of itself there."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from vaoi_station.acquisition.controller.protocol import Ident

VECTORS: dict[str, Any] = json.loads(
    (Path(__file__).resolve().parents[3] / "hw" / "protocol_vectors.json").read_text(encoding="utf-8")
)
IDENT = Ident.unpack(bytes.fromhex(next(f["payload"] for f in VECTORS["frames"] if f.get("struct") == "Ident")))
