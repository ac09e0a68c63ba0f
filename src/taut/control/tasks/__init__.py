"""Tasks: phases, their guards and references."""
