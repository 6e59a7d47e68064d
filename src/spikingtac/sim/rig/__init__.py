"""The simulated robot rig: arm, grasped probe, gel pads, walls, and a place to probe."""
