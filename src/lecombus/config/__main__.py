"""`python -m lecombus.config` writes the roster's JSON Schema on standard output.

The file that is shipped is made by `python -m lecombus.config > config/roster.schema.json`. An
editor with a YAML language server uses it by a roster's first line
`# yaml-language-server: $schema=PATH/roster.schema.json`.
"""

import json
import sys

from lecombus.config.keys import roster_json_schema

sys.stdout.write(json.dumps(roster_json_schema(), indent=2, ensure_ascii=False) + "\n")
