"""Scenario files: a run described in TOML."""
