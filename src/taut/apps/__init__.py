"""Ways in: the command line and scenario files."""
