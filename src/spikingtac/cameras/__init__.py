"""Cameras, one file each; ``events/camera.py`` names them by the kind in their address."""
