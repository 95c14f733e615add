"""Stitch a run: compute its image matrices, CAD matrix and verdict from its frames (section 3.3 of the paper).

`work` divides a run into tasks, which are performed as soon as their frames have arrived. `conclude` computes the
result from the evidence of these tasks. `recordings.offline` performs all tasks of a recording.
"""
