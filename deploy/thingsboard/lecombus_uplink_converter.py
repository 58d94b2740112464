"""Converts what `lecombus bridge mqtt` publishes for the ThingsBoard gateway.

A device is a drive, named LINE/DRIVE. Its telemetry: each value that is good, by its code, at the
time at which it was read; its state; what its motor does; its fault's number. What is stale or bad
is left out, so ThingsBoard never shows it as new. The line is a device too, with its state.

Install: /var/lib/thingsboard_gateway/extensions/mqtt/ of the gateway; lecombus_mqtt.json names it.
"""

from datetime import datetime

from thingsboard_gateway.connectors.mqtt.mqtt_uplink_converter import MqttUplinkConverter
from thingsboard_gateway.gateway.entities.converted_data import ConvertedData
from thingsboard_gateway.gateway.entities.datapoint_key import DatapointKey
from thingsboard_gateway.gateway.entities.telemetry_entry import TelemetryEntry

DRIVE_PROFILE = "lecombus drive"
LINE_PROFILE = "lecombus line"


class LecombusUplinkConverter(MqttUplinkConverter):
    """Converts one message.

    Args:
        config: The mapping's configuration.
        logger: The gateway's log.
    """

    def __init__(self, config, logger):
        self._log = logger
        self._config = config.get("converter")

    @property
    def config(self):
        """What the mapping says of the converter."""
        return self._config

    @config.setter
    def config(self, value):
        self._config = value

    def convert(self, topic, data):
        """Return the data of a device, in a list; empty where the message says nothing.

        Args:
            topic: Such as lecombus/hall-3/feeder/json.
            data: A document, or the text of a state. An empty text: the drive left the roster.
        """
        levels = topic.split("/")
        if isinstance(data, dict) and levels[-1] == "json" and len(levels) > 3:
            return [drive_data(f"{levels[-3]}/{levels[-2]}", data)]
        if isinstance(data, str) and data and levels[-1] == "state":
            is_line = len(levels) == 3
            name = levels[1] if is_line else f"{levels[-3]}/{levels[-2]}"
            found = ConvertedData(name, LINE_PROFILE if is_line else DRIVE_PROFILE)
            add(found, {"state": data})
            return [found]
        if data:
            self._log.warning("not from lecombus, or another version of it: %s", topic)
        return []


def drive_data(name, document):
    """Return the data of a drive."""
    found = ConvertedData(name, DRIVE_PROFILE)
    for key in ("family", "address"):
        found.add_to_attributes(DatapointKey(key), document[key])
    fault = document["fault"]
    add(found, {"state": document["state"], "doing": document["doing"]})
    # 0: no fault, which is only known while its status words are. The number of a fault may follow
    # a moment after the trip.
    number = 0 if fault is None else fault["number"]
    if number is not None and document["states"] is not None:
        add(found, {"fault": number})
    for code, value in document["values"].items():
        if value["quality"] != "good" or value["value"] is None:
            continue
        add(found, {code: value["value"]}, value["time"])
        if value["unit"]:
            found.add_to_attributes(DatapointKey(f"{code} unit"), value["unit"])
    return found


def add(found, values, time=None):
    """Add telemetry, at a time such as 2026-11-23T09:10:42.030Z; None: now."""
    at_ms = None
    if time is not None:
        at_ms = round(datetime.fromisoformat(time.replace("Z", "+00:00")).timestamp() * 1000)
    keyed = {DatapointKey(key): value for key, value in values.items()}
    found.add_to_telemetry(TelemetryEntry(keyed, at_ms))
