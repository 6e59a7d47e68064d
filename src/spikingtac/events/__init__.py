"""Events: sources, formats, windows and filters.

Public names are listed in ``__init__.pyi`` and imported when they are first used; the function
``windows`` stays in ``spikingtac.events.windows``, since the module's name would hide it.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
