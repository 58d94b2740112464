"""Another baud rate for a whole line: checked, written drive by drive, confirmed, or taken back.

Read `talk` for what is said and heard, `drives` for what is known of each drive meanwhile,
`checking` for what must hold before anything is written, `moving` for the procedure and its way
back, `telling` for what is said at the end. Why it is done so: docs/adr/0024.

Everything is written as generators that yield what is to be said, at which baud rate, and are sent
what came of it. Whoever drives them opens the port at that rate. No daemon may be on the line: all
drives share one rate, and nobody can feed those that are at another.

Must not live here: ports, time, signals, files, questions to people.
"""

from __future__ import annotations

from lecombus.rebaud.checking import Obstacle, check
from lecombus.rebaud.drives import Drive, Place, Subject
from lecombus.rebaud.moving import Rebaud
from lecombus.rebaud.talk import Came, Read, Said, Step, Steps, Wait, Write
from lecombus.rebaud.telling import Ending, ending_of, situation, what_to_do

__all__ = [
    "Came",
    "Drive",
    "Ending",
    "Obstacle",
    "Place",
    "Read",
    "Rebaud",
    "Said",
    "Step",
    "Steps",
    "Subject",
    "Wait",
    "Write",
    "check",
    "ending_of",
    "situation",
    "what_to_do",
]
