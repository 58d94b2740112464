"""Protocols that a test makes known, for that test alone."""

from __future__ import annotations

import pytest

from lecombus.drives import family_files
from lecombus.fieldbus import protocols
from lecombus.parameters import codes

__all__ = ["known_protocols_kept"]


def known_protocols_kept(patch: pytest.MonkeyPatch) -> None:
    """Have what is known of protocols, and by them of families, put back after the test."""
    patch.setattr(protocols, "_KNOWN", dict(protocols._KNOWN))
    patch.setattr(codes, "_KNOWN", dict(codes._KNOWN))
    patch.setattr(family_files, "_ADDED", dict(family_files._ADDED))
