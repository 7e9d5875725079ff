"""Published laws for redundant robots, to compare with; each tracks a task and draws the joints to a posture."""
