"""The simulated event camera: settings, light on its pixels, pixels, readout."""
