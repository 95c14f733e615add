"""Heights of components above the board, from all frames that show a component.

A body of height h is shifted between two frames in proportion to h (parallax). For each candidate height, the pictures
of the component's footprint are compared on the plane at that height, in all frames at once. A true height makes them
equal. The estimate is free of the links of stitching; it uses matrices, surface and pixels only.
"""
