"""Sensors of joints and of the tool; `taut.sensors` gives them by name."""
