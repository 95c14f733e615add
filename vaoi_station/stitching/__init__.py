"""Stitch a run: compute its image matrices, CAD matrix and verdict from its frames (section 3.3 of the paper).

`work` divides a run into tasks, which are performed as soon as their frames have arrived, and stitches all frames of a
recording. `conclude` computes the result from the evidence of these tasks.

Arguments and fields of these names mean the same everywhere: `scene` the cameras and good frames of a run, `motion`
that of its rows, `rows` (m, 3, 3) the matrices D_j, `plane` the CAD plane of the board type, `c` (4,) the parameters
(a, b, x, y) of C, `cad_matrix` the same as a matrix (3, 3) from CAD to tester coordinates, `problem` and `adjusted` an
adjustment and its solution, `points` the k observed points with known CAD coordinates, `residual_px` (k, 2) their
residuals, `px_per_mm` the resolution, `velocity_mm_s` (2,) the nominal velocity of the belt.
"""
