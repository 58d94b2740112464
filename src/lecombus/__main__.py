"""`python -m lecombus` is `lecombus`."""

from __future__ import annotations

import sys

from lecombus.cli import main

if __name__ == "__main__":
    sys.exit(main())
