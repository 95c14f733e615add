"""Stitch as the paper does, as a baseline to compare with."""
