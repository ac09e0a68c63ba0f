"""The real-time loop: a robot or a model plant in a process of its own, under safety limits."""
