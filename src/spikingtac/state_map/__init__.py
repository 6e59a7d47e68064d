"""The dynamic state map M(x, y): what the sensor sees, rebuilt from events (paper section IV-A).

Public names are listed in ``__init__.pyi`` and imported when they are first used.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
