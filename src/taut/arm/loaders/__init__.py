"""Readers of model files, all of which make a `Tree`; `arm/lump.py` turns that into an `Arm`."""
