"""What a person does at a drive's keypad: look at a value, set one.

The keypad may set what the line may only read, such as the software in C0200 or P420, within the
limits of the code.
"""

from __future__ import annotations

from lecombus.fieldbus.lecom.simulator.drive import SimDrive
from lecombus.fieldbus.lecom.simulator.parameters import Refusal

__all__ = ["set_value", "value_of"]


def value_of(drive: SimDrive, number: int, subcode: int) -> str:
    """Give a value as wire text.

    Raises:
        ValueError: There is no such code.
    """
    try:
        return drive.text(number, subcode)
    except Refusal:
        raise ValueError(f"{drive.name} has no code C{number:04d}/{subcode}") from None


def set_value(drive: SimDrive, number: int, subcode: int, text: str) -> None:
    """Set a value.

    Args:
        drive: The drive.
        number: 0..65535.
        subcode: 0..255.
        text: A number, a word such as H0008, or a string without its letter.

    Raises:
        ValueError: No such code, no such value, or one that the drive computes itself.
    """
    value_of(drive, number, subcode)
    model = drive.model
    spec = model.params.find(number, subcode)
    if number in model.readers and number not in model.writers:
        raise ValueError(f"C{number:04d} is what the drive itself measures")
    try:
        value = spec.at_keypad(text)
    except Refusal:
        limits = f"{spec.low} to {spec.high}" if spec.writable else "a value of its format"
        raise ValueError(f"C{number:04d} cannot be `{text}`: {limits}") from None
    model.preset((number, subcode), value)
