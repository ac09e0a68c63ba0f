"""References and trajectories, of joints and of the tool; `taut.trajectories` gives them by name."""
