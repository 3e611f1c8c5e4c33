"""The pages and plots of a camera profile."""
