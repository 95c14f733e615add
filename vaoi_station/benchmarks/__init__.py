"""`vaoi bench`: one module per subject."""
