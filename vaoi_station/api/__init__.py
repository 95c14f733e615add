"""The REST service under `/api/v1` and the operator's page."""
