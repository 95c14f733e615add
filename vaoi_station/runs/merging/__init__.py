"""Merged pictures of finished runs: which frames complement each other, and the jobs that merge them."""
