"""Worker processes: job queues, the pool that supervises them, and the code that runs inside each worker."""
