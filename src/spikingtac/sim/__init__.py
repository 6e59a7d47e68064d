"""The digital twin: gel, optics, event camera, robot; the same protocols as the hardware."""
