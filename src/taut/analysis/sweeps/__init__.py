"""Sweeps: many runs of one closed loop, in lanes and threads or in processes; `sweep` is the door."""
