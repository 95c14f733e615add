"""`vaoi plan`: compute cameras, lens, exposure and pulses from requirements (section 2 of the paper)."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Annotated, Any

import typer

from vaoi_station.errors import InputError, NotFoundError

if TYPE_CHECKING:
    from vaoi_station.optics import Requirements

Float = float | None
Int = int | None


def plan(
    *,
    example: Annotated[
        str | None, typer.Option(help="Start from this example ('paper': section 2.6); other options change it.")
    ] = None,
    width_mm: Annotated[Float, typer.Option(help="Widest board, across the motion (w).")] = None,
    resolution_px_per_mm: Annotated[Float, typer.Option(help="Pixels per mm on the board (r).")] = None,
    speed_mm_s: Annotated[Float, typer.Option(help="Conveyor speed (v).")] = None,
    sensor_px_h: Annotated[Int, typer.Option(help="Pixels of a frame across the motion (p_h).")] = None,
    sensor_px_v: Annotated[Int, typer.Option(help="Pixels of a frame along the motion (p_v).")] = None,
    sensor_width_mm: Annotated[Float, typer.Option(help="Width of the sensor, along p_h (w_s).")] = None,
    distance_max_mm: Annotated[Float, typer.Option(help="Largest distance of the cameras (d_max).")] = None,
    distance_min_mm: Annotated[Float, typer.Option(help="Smallest distance of the cameras (d_min).")] = None,
    multiplicity_h: Annotated[Float, typer.Option(help="Number of cameras that see each point (m_h).  [1.05]")] = None,
    multiplicity_v: Annotated[
        Float, typer.Option(help="Number of frames of a camera that see each point (m_v).  [2.1]")
    ] = None,
    depth_of_field_mm: Annotated[Float, typer.Option(help="Height of the highest component (d_f).")] = None,
    circle_of_confusion_mm: Annotated[Float, typer.Option(help="Acceptable blur spot on the sensor (c).")] = None,
    blur_px: Annotated[Float, typer.Option(help="Acceptable motion during an exposure (τ).  [1]")] = None,
    lens_mm: Annotated[Float, typer.Option(help="Focal length of the lens in stock.")] = None,
    f_number: Annotated[Float, typer.Option(help="Aperture in use (N).")] = None,
    cameras: Annotated[Int, typer.Option(help="Number of cameras chosen (n).")] = None,
    frame_rate_hz: Annotated[Float, typer.Option(help="Frame rate chosen (t).")] = None,
    exposure_us: Annotated[Float, typer.Option(help="Exposure time chosen (s).")] = None,
    readout_us: Annotated[Float, typer.Option(help="Readout time that exposures cannot overlap.  [0]")] = None,
    bits_per_pixel: Annotated[Int, typer.Option(help="Bits per pixel on the links.  [8]")] = None,
    longest_board_mm: Annotated[Float, typer.Option(help="Longest board, along the motion.")] = None,
    runs_in_memory: Annotated[Int, typer.Option(help="Number of boards that the ring holds at once.  [3]")] = None,
    link_mbit_s: Annotated[Float, typer.Option(help="Link that all cameras share, or all ports.")] = None,
    camera_link_mbit_s: Annotated[Float, typer.Option(help="Link of one camera, if it is slower.")] = None,
    packet_bytes: Annotated[Int, typer.Option(help="Packet size with headers.  [9000]")] = None,
    json_: Annotated[bool, typer.Option("--json", help="Print JSON for programs instead of a table.")] = False,
) -> None:
    """Plan the optics: cameras, lens, exposure, pulses and memory, with the margin of every constraint."""
    # Every option except these two is a requirement with the same name.
    given = {k: v for k, v in locals().items() if k not in ("example", "json_") and v is not None}
    from vaoi_station.optics import make_plan
    from vaoi_station.optics.report import PAPER, compare_with_paper, format_plan, plan_to_json

    if example not in (None, "paper"):
        raise NotFoundError(f"example {example!r} does not exist.", action="The only example is 'paper'.")
    made = make_plan(_requirements(given, PAPER if example else None))
    # The paper's figures are comparable only with its example, if no option changes a requirement.
    figures = compare_with_paper(made) if example and not given else ()
    typer.echo(json.dumps(plan_to_json(made, figures), indent=1) if json_ else format_plan(made, figures), nl=json_)


def _requirements(given: dict[str, Any], base: Requirements | None) -> Requirements:
    from dataclasses import MISSING, fields, replace

    from vaoi_station.optics import Requirements

    if base is not None:
        return replace(base, **given)
    required = [f.name for f in fields(Requirements) if f.default is MISSING]
    missing = [f"--{name.replace('_', '-')}" for name in required if name not in given]
    if missing:
        raise InputError(
            f"requirements: {', '.join(missing)} must be given.", action="Give them, or start from --example paper."
        )
    return Requirements(**given)
