"""taut: control laws for robot arms, written once and run everywhere."""
