"""Where to put the probe after the tester has clamped the board: python probe_a_clamped_board.py STATION

It takes the run that finished last, and reads its fiducials: here with a stand-in that has turned the board by 30°.
A real tester's program replaces `read_fiducial`.
"""

import math
import sys

import vaoi_station as vaoi

SIGMA_MM = 0.008
"""Standard deviation of a reading of this tester."""
CLEARANCE_MM = 3.0
"""Height above the board at which its probes travel."""
TURN_DEG = 30.0
"""How boards lie in its clamp: the angle of the CAD x axis in its coordinates."""


def read_fiducial(x: float, y: float) -> tuple[float, float]:
    """Move the tester's camera to a fiducial, here one in mm, and return where it is in the tester's coordinates."""
    c, s = math.cos(math.radians(TURN_DEG)), math.sin(math.radians(TURN_DEG))
    return 400.0 + c * x - s * y, 250.0 + s * x + c * y


station = vaoi.connect(sys.argv[1])
run = station.run("latest")
board = station.board_types.get(run.summary["board_type"])
if board.unit != "mm" or board.y_axis != "up":
    sys.exit("read_fiducial, the stand-in, knows boards in mm with y up only")

readings = {fiducial.name: read_fiducial(fiducial.x, fiducial.y) for fiducial in board.fiducials}
answer = run.clamped(
    readings, sigma=SIGMA_MM, turn_deg=TURN_DEG, points=list(run.refs), clearance=CLEARANCE_MM, margin=0.5
)
for reason in answer.reasons:
    print(f"{reason.code}: {reason.message} {reason.action}")
for remark in answer.remarks:
    print(f"note: {remark}")
if answer.status == vaoi.Status.FAILED:
    sys.exit("the board is not probed")

whole = answer.transforms[0]
print(f"clamped: turned by {whole.turn_deg:.4f}°, scale {whole.scale.ppm:+.0f} ± {whole.scale.sigma_ppm:.0f} ppm")
for point in answer.points:
    if max(point.sigma_x, point.sigma_y) > 0.05:
        print(f"{point.name:8s} is not probed: its place is known to {point.sigma_x:.3f} mm only")
        continue
    at = f"x {point.x:9.4f} y {point.y:9.4f} z {point.z:7.4f} mm"
    print(f"{point.name:8s} {at} ± {point.sigma_x:.4f} {point.sigma_z:.4f}")
for solid in answer.keep_outs:
    top = "unknown height" if solid.top is None else f"up to z {solid.top:.2f} mm"
    print(f"keep out {solid.component}: {top}, corners {solid.corners}")
