"""Linear systems: error dynamics, the one-period map of a loop, poles, margins, responses."""
