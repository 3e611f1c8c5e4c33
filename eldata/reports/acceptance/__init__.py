"""The page of a noise model's acceptance test."""
