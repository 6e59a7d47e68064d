"""Prophesee RAW files and streams: EVT2, EVT2.1, EVT3."""
