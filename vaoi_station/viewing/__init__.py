"""`vaoi view`: live frames with focus, exposure and detected marks, for mounting and focusing cameras."""
