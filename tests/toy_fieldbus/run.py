"""`python run.py WORDS ..`: the command `lecombus` with the toy protocol besides."""

from __future__ import annotations

import sys

from lecombus.fieldbus.protocols import register
from toy_fieldbus.toy import TOY

if __name__ == "__main__":
    register(TOY)
    from lecombus.cli import main

    sys.exit(main())
