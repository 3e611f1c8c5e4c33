"""A noise model against frames that it has not seen, and against its own closed forms."""
