"""The whole path on raw files that the package makes itself: no download."""
