"""The paper's stitching method, kept for comparison: `vaoi bench` and `vaoi stitch --method paper` use it."""
