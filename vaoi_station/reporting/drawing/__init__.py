"""Draw HTML and SVG: escaping, axes, curves, thumbnails, the page."""
