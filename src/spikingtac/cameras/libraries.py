"""Import a maker's library, or say what brings it."""

from __future__ import annotations

import importlib
from typing import Any

from spikingtac.errors import DeviceError, MissingExtraError


def require(module: str, package: str, extra: str) -> Any:
    """Return the module of an optional library.

    Args:
        module: Name to import.
        package: Name to install.
        extra: Extra of this package that brings it; empty where the maker alone gives it out.

    Raises:
        MissingExtraError: It is not installed.
        DeviceError: It is installed and cannot be loaded.
    """
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        if error.name is None or error.name.partition(".")[0] != module.partition(".")[0]:
            raise DeviceError(
                f"{package} is installed, but needs {error.name!r}: {error}"
            ) from error
        how = f"pip install 'spikingtac[{extra}]'" if extra else f"install {package} from its maker"
        raise MissingExtraError(
            f"this camera is read by the library {package}, which is not installed; {how}"
        ) from error
    except (ImportError, OSError) as error:
        raise DeviceError(
            f"{package} is installed but cannot be loaded ({error}); install it again"
        ) from error
