"""The skin as an elastic layer: how it moves under forces."""
