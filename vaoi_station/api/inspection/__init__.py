"""What an engineer sees of one run beside its pictures: the times of its steps, and what is drawn over the board."""
