"""`python run.py WORDS ..`: the command `lecombus` with the toy protocol besides.

With `WITHOUT_LECOM` in the environment nothing can import `lecombus.fieldbus.lecom`.
"""

from __future__ import annotations

import os
import sys

from lecombus.fieldbus.protocols import register
from toy_fieldbus.toy import TOY

if __name__ == "__main__":
    if os.environ.get("WITHOUT_LECOM"):
        sys.modules["lecombus.fieldbus.lecom"] = None  # type: ignore[assignment]
    register(TOY)
    from lecombus.cli import main

    sys.exit(main())
