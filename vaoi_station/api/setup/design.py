"""The nominal views of the cameras: those of station.toml, and those that a caller states where it has none."""

from __future__ import annotations

from collections.abc import Sequence

from vaoi_station.errors import InputError
from vaoi_station.model import CameraHead


def nominal_heads(
    heads: Sequence[CameraHead], pitch_mm: float | None = None, px_per_mm: float | None = None
) -> tuple[CameraHead, ...]:
    """Return the cameras with nominal views; what is missing follows from an evenly spaced array.

    Camera 0 is then at the origin and the others along x, as on the artwork of a calibration board.

    Args:
        heads: the cameras as station.toml states them.
        pitch_mm: distance of neighbouring cameras.
        px_per_mm: resolution of the cameras.

    Raises:
        InputError: a nominal value is neither in station.toml nor given.
    """
    placed = all(head.nominal_center_mm is not None for head in heads)
    scaled = all(head.nominal_px_per_mm is not None for head in heads)
    # The distance of a single camera to its neighbours does not matter.
    pitch = pitch_mm or (1.0 if placed or len(heads) == 1 else None)
    if pitch is None or not (scaled or px_per_mm):
        raise nominal_values_missing(pitch_mm=pitch, px_per_mm=1.0 if scaled else px_per_mm)
    return tuple(
        head.model_copy(
            update={
                "nominal_center_mm": head.nominal_center_mm if placed else (n * pitch, 0.0),
                "nominal_px_per_mm": head.nominal_px_per_mm or px_per_mm,
            }
        )
        for n, head in enumerate(heads)
    )


def nominal_values_missing(**values: object) -> InputError:
    """Return the refusal of an array whose distance or resolution, by its parameter's name, is None."""
    missing = [name for name, value in values.items() if value is None]
    return InputError(
        f"{' and '.join(missing)} must be given.",
        action="Give them, or nominal_center_mm and nominal_px_per_mm of the cameras in station.toml.",
        code="nominal-values-missing",
    )
