"""Log files: MCAP, CSV, MAT; what is written and read."""
