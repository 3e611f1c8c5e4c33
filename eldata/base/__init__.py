"""What is not about photographs: files, workers, console, tables, and how kernels are compiled."""
