"""Readers of model files, all of which make a `Tree`; `arm/loaders/lump.py` turns that into an `Arm`."""
