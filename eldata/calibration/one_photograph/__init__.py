"""A camera profile from one raw photograph."""
