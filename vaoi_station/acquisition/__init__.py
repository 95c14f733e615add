"""From light barrier to frames in shared memory: controller, cameras, ring, recorder."""
