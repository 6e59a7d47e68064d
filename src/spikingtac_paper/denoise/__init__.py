"""The denoising experiment, and training runs."""
