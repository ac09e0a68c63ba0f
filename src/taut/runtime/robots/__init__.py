"""Engines and robots that are not ours."""
