"""What a calibration would still need, told while events come."""
