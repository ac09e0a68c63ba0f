"""Natural and artificial constraints, and which forces a contact admits."""
