"""Pictures and drawings of a design; needs the extra ``[design]``."""
