"""What vibrates: the spectrum of the displacement."""
