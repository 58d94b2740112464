"""A child: a controller that keeps one drive running under a lease, until it is killed or stopped.

`python -m support.lease_client WHERE DRIVE SPEED TIME [TOKEN_FILE]`, WHERE a socket or a URL. It
takes the lease `plc`, enables the drive, gives it a speed, prints `running` and renews. When a
renewal is refused it tries to move the drive with its token once more, prints what that was
answered, and ends.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path
from threading import Thread

import httpx2

__all__ = ["main"]

RENEWALS = 5
"""In the time of a lease."""


def main() -> None:
    """Run until a renewal is refused."""
    where, drive, speed, time_s, *token_file = sys.argv[1:]
    with connected(where, *token_file) as client, connected(where, *token_file) as other:
        lease = "/v1/leases/plc"
        asked = {"targets": [drive], "time": f"{time_s}s", "counter": 0}
        token = client.put(lease, json=asked).raise_for_status().json()["token"]
        other.headers["Lecombus-Lease"] = token
        # On a full line an enable takes longer than the lease: renewals do not wait for it.
        starting = Thread(target=start, args=(other, drive, float(speed)))
        starting.start()
        counter = 1
        while client.put(lease, json={"token": token, "counter": counter}).status_code == 200:
            counter += 1
            time.sleep(float(time_s) / RENEWALS)
        starting.join()
        say(moved(other, drive, float(speed)))


def connected(where: str, token_file: str = "") -> httpx2.Client:
    """Return a connection to the daemon."""
    if token_file:
        bearer = {"Authorization": f"Bearer {Path(token_file).read_text().strip()}"}
        return httpx2.Client(base_url=where, headers=bearer, timeout=60.0)
    transport = httpx2.HTTPTransport(uds=where)
    return httpx2.Client(transport=transport, base_url="http://lecombus", timeout=30.0)


def start(client: httpx2.Client, drive: str, speed: float) -> None:
    """Have the drive run; it may not have been audited yet."""
    while (end := moved(client, drive, speed)) in ("offline", "starting"):
        time.sleep(0.1)
    say("running" if end == "moved" else end)


def moved(client: httpx2.Client, drive: str, speed: float) -> str:
    """Enable the drive and give it a speed; gives `moved`, or the word of the problem."""
    path = f"/v1/drives/{drive}/verbs"
    answer = client.post(f"{path}/enable")
    if answer.status_code == 200:
        answer = client.post(f"{path}/set-speed", json={"value": speed, "unit": "Hz"})
    if answer.status_code == 200:
        return "moved"
    return str(answer.json()["type"]).rpartition(":")[2]


def say(text: str) -> None:
    """Say it to the parent."""
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main()
