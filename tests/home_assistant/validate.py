"""Validates discovery payloads as Home Assistant does, with its own schemas.

Run by an interpreter that has Home Assistant, which needs a newer Python than lecombus:
reads `{topic: payload}` as JSON from standard input, writes what is wrong, one a line.
Beyond Home Assistant's own check, a key that it does not know is wrong too.
"""

# mypy: ignore-errors

import json
import sys
from importlib import import_module

import voluptuous as vol
from homeassistant.components.mqtt import discovery
from homeassistant.components.mqtt.discovery import MQTTDiscoveryPayload
from homeassistant.helpers.template import Template


def mistakes(topic, text):
    """Give what is wrong with one payload."""
    found = MQTTDiscoveryPayload(json.loads(text))
    discovery._replace_all_abbreviations(found)
    try:
        discovery.DEVICE_DISCOVERY_SCHEMA(found)
    except vol.Invalid as exc:
        yield f"{topic}: {exc}"
        return
    for key, component in found["components"].items():
        if component.keys() == {"platform"}:
            continue  # with nothing else it is removed, and never reaches the platform's schema
        config = MQTTDiscoveryPayload(
            {**component, "device": found["device"], "origin": found["origin"]}
        )
        platform = config.pop("platform")
        discovery._merge_common_device_options(config, found)
        module = import_module(f"homeassistant.components.mqtt.{platform}")
        try:
            kept = module.DISCOVERY_SCHEMA(dict(config))
        except vol.Invalid as exc:
            yield f"{topic}: {key}: {exc}"
            continue
        for left_out in config.keys() - kept.keys():
            yield f"{topic}: {key}: Home Assistant does not know `{left_out}`"
        for value in kept.values():
            if isinstance(value, Template):
                value.ensure_valid()


if __name__ == "__main__":
    for one_topic, one_text in json.load(sys.stdin).items():
        for mistake in mistakes(one_topic, one_text):
            sys.stdout.write(f"{mistake}\n")
