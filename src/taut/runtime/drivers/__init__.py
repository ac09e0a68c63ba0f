"""Drivers of engines and robots that are not ours."""
