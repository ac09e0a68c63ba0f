"""What every room may use: errors, checks, poses, the traced scalar and its graph, taut.math."""
