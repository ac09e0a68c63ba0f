"""Ordinary NumPy code becomes a graph: scalars, arrays, derivatives, linear algebra, poses."""
