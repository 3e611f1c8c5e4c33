"""Benchmarks of the hot paths, each against the straightforward way and against the floor: ``python -m benchmarks``."""
