"""What is not about photographs."""
