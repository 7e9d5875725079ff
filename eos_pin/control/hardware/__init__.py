"""The loop of a real robot: connections, the runner that drives them, and a log that outlives it."""
