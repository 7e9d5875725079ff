"""The bench: laws beside each other, on the same robots, under the same disturbances, with gains found alike."""
