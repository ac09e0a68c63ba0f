"""What a controller makes of its measurements: filters, velocity, wrist wrench."""
