"""The journal: who did what, and what happened to the line, in a file that survives."""
