"""The doctor: why a run is as it is."""
