"""Tester coordinates of every component of a stitched recording: python probe_coordinates.py RECORDING RESULT"""

import sys

import numpy as np

import vaoi_station as vaoi

run = vaoi.open_recording(sys.argv[1]).with_result(sys.argv[2])
if run.cad_matrix is None or run.status != vaoi.Status.OK:
    sys.exit(f"not probed: {run.status}: {' '.join(run.reasons)}")
for ref in run.refs:
    # A component that local fiducials place has a C of its own.
    x, y, w = run.component_matrix(ref) @ np.array([*run.center(ref), 1.0])
    print(f"{ref:8s} {x / w:9.4f} mm {y / w:9.4f} mm")
