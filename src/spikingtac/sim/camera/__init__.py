"""The event camera: pixels, light, noise and readout."""
