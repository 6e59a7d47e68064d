"""The verbs ``experiment``, ``bench`` and ``train`` of the command line."""
