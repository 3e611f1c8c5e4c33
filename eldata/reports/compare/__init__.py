"""The pages and plots that hold methods against each other."""
