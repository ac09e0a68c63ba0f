"""Motors, gears and drivetrains; `taut.drives` gives them by name."""
