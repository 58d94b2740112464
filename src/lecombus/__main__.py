"""`python -m lecombus` is `lecombus`: where every command starts.

Importing what a command needs takes a tenth of a second, and a Ctrl-C in that time has nothing to
tell but that it was pressed. So until the command itself runs, and again when it is over, SIGINT
ends the process by itself, as it does a program that knows nothing of it. For the milliseconds
before the first line here `bin/lecombus` holds it back.
"""

import os
import sys


def _without_interrupt(kind, value, trace):  # type: ignore[no-untyped-def] # nothing is imported yet
    """Show an error as always, but no traceback of a Ctrl-C."""
    if not issubclass(kind, KeyboardInterrupt):
        sys.__excepthook__(kind, value, trace)


sys.excepthook = _without_interrupt

import signal  # noqa: E402 - it takes milliseconds itself

HELD_BACK = "LECOMBUS_HELD_BACK"
"""Set by `bin/lecombus` where it holds SIGINT back."""


def main() -> int:
    """Run the command line; returns the exit status."""
    # A job in the background may have been started deaf to it, and stays so.
    listens = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if listens:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    if os.environ.pop(HELD_BACK, ""):
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    _open_streams()
    _take_name()
    from lecombus.cli import main as command

    try:
        if listens:
            signal.signal(signal.SIGINT, signal.default_int_handler)
        return int(command())
    finally:
        if listens:
            signal.signal(signal.SIGINT, signal.SIG_DFL)


def _open_streams() -> None:
    """Put /dev/null where a stream was closed: else the port may get its number, and be written to.

    The first free number is that of the closed stream, which are opened in their order.
    """
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, mode, encoding="utf-8"))  # noqa: PTH123, SIM115


def _take_name() -> None:
    """Be called `lecombus` in lists of processes, and where a port in use names its holder."""
    try:
        with open("/proc/self/comm", "w", encoding="ascii") as comm:  # noqa: PTH123 - light
            comm.write("lecombus")
    except OSError:
        pass


if __name__ == "__main__":
    sys.exit(main())
