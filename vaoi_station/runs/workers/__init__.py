"""Worker processes: the job queues, the pool that supervises the processes, and the code that runs in each of them."""
