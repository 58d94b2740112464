"""httpx without its own command line.

`import httpx` imports `httpx._main` where rich happens to be installed, and with it rich, pygments
and more: 30 ms and more before `lecombus stop` says a word. httpx does without where that module
cannot be imported, so it is made so for the moment of the import.

What must not live here: anything but that import.
"""

from __future__ import annotations

import sys

_UNWANTED = "httpx._main"

if _UNWANTED in sys.modules:
    import httpx
else:
    sys.modules[_UNWANTED] = None  # type: ignore[assignment]
    import httpx

    del sys.modules[_UNWANTED]

__all__ = ["httpx"]
