"""What a calibration still needs, updated while events come."""
