"""``python -m spikingtac`` is the same as the command ``spikingtac``."""

import sys

from spikingtac.cli.main import main

if __name__ == "__main__":
    sys.exit(main())
