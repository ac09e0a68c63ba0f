"""The laws, and what surrounds them on the controller side: sensing, limits, references."""
