"""Why the good frames show too little of a component; schemas of replies name it without the code that finds it."""

from __future__ import annotations

from typing import Literal

Cause = Literal["frames-unconfirmed", "frames-lost", "filming-ended", "filming-began", "seam", "beyond-view"]
