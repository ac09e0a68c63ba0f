"""Gains from a specification."""
