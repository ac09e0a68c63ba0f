"""Study: what loops can do before they run, and what many runs mean."""
