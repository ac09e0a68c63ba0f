"""Stability over parameters and states: root loci, maps, limit cycles, regions of attraction."""
