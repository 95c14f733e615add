"""Quality of a result: component heights, uncertainty, agreement with CAD data, and the verdict with its reasons."""
