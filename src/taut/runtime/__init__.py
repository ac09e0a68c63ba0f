"""Things with a clock: simulation, and drivers of engines and robots."""
