"""`python -m lecombus.config` writes the roster's JSON Schema on standard output.

The file that is shipped is made by `python -m lecombus.config > config/roster.schema.json`.
"""

import sys

from lecombus.config.schema import schema_text

sys.stdout.write(schema_text())
