"""Synthetic pairs and clips: draws, noise made on the fly, and sets of it on disk."""
