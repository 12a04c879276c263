"""What lies in results/: when, which experiment, what differs from its file as it is now, and what may go."""
