"""The simulated robot rig: arm, grasped probe, gel pads and walls."""
