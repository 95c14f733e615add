"""Images of a component under one light, best first: python images_of_one_light.py http://127.0.0.1:8350 U7 left FOLDER

The same call works for a recording: `vaoi.open_recording(CASE).stitch().component("U7", light="left")`.
"""

import sys
from pathlib import Path

import vaoi_station as vaoi

address, ref, light, folder = sys.argv[1], sys.argv[2], sys.argv[3], Path(sys.argv[4])
images = vaoi.connect(address).run("latest").component(ref, light=light, margin_mm=0.5, measure=True)
for k, image in enumerate(images):
    angle = "unknown" if image.view_angle_deg is None else f"{image.view_angle_deg:.1f}°"
    sharpness = "unknown" if image.sharpness_per_mm is None else f"{image.sharpness_per_mm:.1f} per mm"
    print(f"camera {image.camera}, row {image.row}, {image.exposure_us} µs: angle {angle}, sharpness {sharpness}")
    vaoi.write_image(folder / f"{ref}_{light}_{k:02d}.png", image.pixels)
