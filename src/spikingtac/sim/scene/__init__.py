"""Scenes: what touches the skin and how, as a stream or as a recording folder."""
