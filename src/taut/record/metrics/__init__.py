"""Metrics: how well a run went, in numbers; each is declared once, by one function."""

from taut.record.metrics import joints as joints  # first: the order in which they are shown
from taut.record.metrics import tool as tool
from taut.record.metrics.declaration import METRICS, Metric, Metrics
from taut.record.metrics.joints import MOVING, RESTING, stuck

__all__ = ["METRICS", "MOVING", "RESTING", "Metric", "Metrics", "stuck"]
