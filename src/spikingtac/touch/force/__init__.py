"""From displacements to forces: laws learned from labelled contacts, with their intervals."""
