"""The lens, the skin's discs, and the values between gel, lens and camera."""
