"""Pictures of many components of a run over REST: the parameters, and the stream of parts in order of readiness."""
