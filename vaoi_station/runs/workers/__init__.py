"""Run jobs on worker processes: queues, the pool, what a worker remembers between jobs."""
