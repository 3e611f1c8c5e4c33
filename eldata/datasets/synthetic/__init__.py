"""Synthetic pairs and clips: what is drawn, noise made on the fly, and sets of it on disk."""
