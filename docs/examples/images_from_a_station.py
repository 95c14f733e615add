"""Images of one component from a running station: python images_from_a_station.py http://127.0.0.1:8350 U1 FOLDER

On another machine than the station: VAOI_KEY_FILE=tester.key VAOI_CA=ca.pem python images_from_a_station.py …
"""

import sys
from pathlib import Path

import vaoi_station as vaoi

address, ref, folder = sys.argv[1], sys.argv[2], Path(sys.argv[3])
run = vaoi.connect(address).run("latest")
print(f"run {run.id}: {run.status} {' '.join(run.reasons)}")
for k, image in enumerate(run.component(ref)):
    vaoi.write_image(folder / f"{ref}_{k:02d}.png", image.pixels)
