"""Stitch as the paper does: the baseline of `vaoi bench` and `vaoi stitch --method paper`."""
