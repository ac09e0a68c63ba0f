"""What acts on the tool; `taut.environments` gives them by name."""
