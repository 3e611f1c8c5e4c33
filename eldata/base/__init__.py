"""What is not about photographs: files, text fields, workers, console, tables, and how kernels are compiled."""
