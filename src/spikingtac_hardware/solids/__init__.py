"""Solids of the parts; needs the extra ``[design]``."""
