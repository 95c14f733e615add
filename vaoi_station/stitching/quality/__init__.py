"""Judge a stitch: component heights, uncertainty, agreement with the CAD data, and the verdict with its reasons."""
