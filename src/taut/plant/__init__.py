"""Models of the other half of the loop, written in the same style as the laws."""
