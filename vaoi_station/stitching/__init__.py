"""From frames to matrices: links, motion, adjustment, CAD mapping, verdict (section 3.3 of the paper).

`work` cuts a run into tasks that can be done while it is still being filmed; `offline` does them all
for a recording.
"""
