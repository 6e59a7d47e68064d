"""The verbs, one a module with ``Args`` and ``run(args)``, and what only one of them needs."""
