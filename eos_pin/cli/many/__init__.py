"""Commands of many runs: one table, one figure."""
