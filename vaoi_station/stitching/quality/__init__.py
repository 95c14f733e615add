"""Judge a result: covariances, predicted uncertainty, agreement of the evidence, component heights, verdict."""
