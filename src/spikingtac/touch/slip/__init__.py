"""Slip: how much of a contact still sticks, and when none of it does."""
