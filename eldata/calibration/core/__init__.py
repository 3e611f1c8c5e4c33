"""Frames to figures: estimators, and the findings that say what of their figures holds."""
