"""As much of JSON Schema as the roster's schema uses, to hold the examples against it."""

from __future__ import annotations

import re
from typing import Any

NAMES: dict[str, Any] = {
    "object": dict, "array": list, "string": str, "boolean": bool, "integer": int,
    "number": (int, float),
}  # fmt: skip
KNOWN = {
    "$schema", "title", "description", "default", "type", "properties", "additionalProperties",
    "required", "propertyNames", "items", "minItems", "enum", "const", "not", "anyOf", "pattern",
    "minLength", "maxLength", "minimum", "maximum", "multipleOf",
}  # fmt: skip


def matches(schema: Any, value: Any) -> bool:
    """Tell whether a value is valid; a keyword this does not know is an error of the test."""
    if isinstance(schema, bool):
        return schema
    assert set(schema) <= KNOWN, set(schema) - KNOWN
    return _plain(schema, value) and _inside(schema, value)


def _is(name: str, value: Any) -> bool:
    return isinstance(value, NAMES[name]) and (name == "boolean" or not isinstance(value, bool))


def _plain(schema: dict[str, Any], value: Any) -> bool:
    types = schema.get("type", [])
    types = [types] if isinstance(types, str) else types
    text = value if isinstance(value, str) else None
    number = value if isinstance(value, (int, float)) and not isinstance(value, bool) else None
    return all((
        not types or any(_is(name, value) for name in types),
        "enum" not in schema or any(value is known or (
            value == known and type(value) is type(known)) for known in schema["enum"]),
        "const" not in schema or value == schema["const"],
        "not" not in schema or not matches(schema["not"], value),
        "anyOf" not in schema or any(matches(one, value) for one in schema["anyOf"]),
        text is None or re.search(schema.get("pattern", ""), text) is not None,
        text is None or schema.get("minLength", 0) <= len(text) <= schema.get("maxLength", 9999),
        number is None or schema.get("minimum", number) <= number <= schema.get("maximum", number),
        number is None or "multipleOf" not in schema or number % schema["multipleOf"] == 0,
    ))  # fmt: skip


def _inside(schema: dict[str, Any], value: Any) -> bool:
    if isinstance(value, list):
        return len(value) >= schema.get("minItems", 0) and all(
            matches(schema.get("items", True), item) for item in value
        )
    if not isinstance(value, dict):
        return True
    properties = schema.get("properties", {})
    other = schema.get("additionalProperties", True)
    return (
        all(name in value for name in schema.get("required", []))
        and all(matches(schema.get("propertyNames", True), name) for name in value)
        and all(matches(properties.get(name, other), item) for name, item in value.items())
    )
