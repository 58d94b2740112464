"""Messages to people, by a command or by mail, when something happens on a line.

`conditions` finds out what happens from the picture of a line (`line_follower`), `messages` puts
what happened since the last message into one, `channels` sends it, `bridge` runs all of them.
A channel that fails or waits holds up no other, and keeps no more than one entry for each drive and
kind of event.
"""
