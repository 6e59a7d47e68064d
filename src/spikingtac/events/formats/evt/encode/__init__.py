"""Write EVT2, EVT2.1 and EVT3."""
