"""Section 10.6 of the chapter: laws for what the model does not know, and for joints that give."""
