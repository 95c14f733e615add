"""Compare the components in the pictures with the CAD mapping: evidence independent of fiducials and outline."""
