"""Constraints of the tool and joints: rows, rates, multipliers, projections, impulses."""
