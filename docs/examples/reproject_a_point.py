"""Where a CAD point is in every frame of a simulated board, against the truth: python reproject_a_point.py FOLDER"""

import json
import sys
from pathlib import Path

import numpy as np

import vaoi_station as vaoi

folder = Path(sys.argv[1])
run = vaoi.simulate("small", folder, board=1).stitch()
truth = json.loads((folder / "truth.json").read_text())
errors = []
for camera, row, x, y in truth["views"]["U1"]:
    estimated = {(i, j): (u, v) for i, j, u, v in (run.result.components or {})["U1"]}
    if (camera, row) in estimated:
        errors.append(np.hypot(*np.subtract(estimated[camera, row], (x, y))))
print(f"U1 in {len(errors)} frames: {max(errors):.3f} px at most from the truth")
