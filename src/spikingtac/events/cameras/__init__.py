"""Cameras as sources of events: the protocol, the kinds by name, and what every camera reports."""
