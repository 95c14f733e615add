"""Live frames with their focus, exposure and the marks in them: for mounting and focusing cameras (`vaoi view`)."""
