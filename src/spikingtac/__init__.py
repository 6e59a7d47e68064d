"""Event-camera tactile sensing: from raw events to marker displacements and contacts.

The public names stand in ``__init__.pyi`` and are imported when they are first used, so that
``import spikingtac`` costs a few milliseconds and loads neither NumPy nor Numba nor SciPy.
"""

from typing import Any

import lazy_loader

from spikingtac.kernels import provide_kernel_cache

_public_name, _, __all__ = lazy_loader.attach_stub(__name__, __file__)
__all__ += ["__version__"]

provide_kernel_cache()


def __getattr__(name: str) -> Any:
    """Import a public name from its module when it is first used."""
    if name == "__version__":
        from spikingtac._version import package_version

        return package_version()
    if name not in __all__:
        raise AttributeError(f"module 'spikingtac' has no attribute {name!r}")
    return _public_name(name)


def __dir__() -> list[str]:
    """List the public names, imported or not."""
    return list(__all__)
