"""What runs and readings mean: calibration."""
