"""The control laws, a module for each family; `taut.laws` gives them by name."""
