"""State: the little that must outlive the process, in one file a line.

`state` is what is kept of each drive: its accepted identity, how often its stored parameters were
written, where it was moved to, and its last enable where that failed. It reads its file and puts it
on disk so that a power failure leaves the old or the new one, never half of one. `keeping` writes
it every few seconds.

What must not live here: what any of it means. That is `operations` (identities, wear, readdress,
why).
"""

from lecombus.saved_state.keeping import Keeping
from lecombus.saved_state.state import DriveFacts, LastEnable, Moved, State, StateFile

__all__ = ["DriveFacts", "Keeping", "LastEnable", "Moved", "State", "StateFile"]
