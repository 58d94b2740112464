"""The demo: `play` runs the whole daemon on simulated drives, `view` shows them."""

from lecombus.demo.play import run_demo

__all__ = ["run_demo"]
