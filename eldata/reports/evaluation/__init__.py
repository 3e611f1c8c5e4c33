"""The pages and plots of an evaluation."""
