"""Draw the parts of the report as HTML and SVG: axes, curves, thumbnails, the page around them."""
