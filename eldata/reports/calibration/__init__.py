"""The pages and plots of a calibration."""
