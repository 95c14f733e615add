"""From frames to matrices: links, motion, adjustment, CAD mapping, verdict (section 3.3 of the paper).

`work` divides a run into tasks that can be performed while it is still being filmed; `recordings.offline` performs them
all for a recording.
"""
