"""From a recording to a figure of U1 in every frame that shows it: python figure_of_a_component.py FOLDER"""

import sys
from pathlib import Path

import vaoi_station as vaoi

folder = Path(sys.argv[1])
recording = vaoi.simulate("small", folder / "recording")  # or vaoi.open_recording(PATH)
run = recording.stitch()
images = run.component("U1")
for image in images:
    print(f"camera {image.camera} row {image.row}: {image.pixels.shape}, {image.coverage:.0%} of U1 in the frame")
vaoi.write_image(folder / "U1.png", images.figure())
run.save(folder / "result.json")
print(f"{run.status}: {len(images)} images of U1, height {images.height_mm} mm")
