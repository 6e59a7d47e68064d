"""Live operation: cameras that are read into rings, recorders, sensors in processes of their own.

Public names are listed in ``__init__.pyi`` and imported when they are first used.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
