"""Stiffness and impedance at the tool."""
