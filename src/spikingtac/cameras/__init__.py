"""Cameras, one file each; ``events/cameras/kinds.py`` names them by the kind in their address."""
