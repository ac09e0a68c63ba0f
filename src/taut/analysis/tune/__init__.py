"""Parameters tuned on simulated runs."""
