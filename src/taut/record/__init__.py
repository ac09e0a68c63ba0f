"""What happened: runs, metrics, plots, videos, log files."""
