"""Programs that users run as they are (``python -m eldata.examples.train_denoiser``), or copy and change."""
