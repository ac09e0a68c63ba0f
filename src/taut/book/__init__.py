"""The chapter's equations and figures, computed with this library's laws, arms and plants."""
