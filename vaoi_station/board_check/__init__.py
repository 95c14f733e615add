"""Lays a board type over a stitched run: whether its components lie where the pictures show them, and what to correct.

The bodies of the board type are compared with the edges in a picture of all that was filmed, in every quarter turn, as
seen and mirrored. So a board type can be checked that no run has been stitched with.
"""
