"""Grbl 1.1, the open motion firmware: its protocol, a rig driven by it, and a simulator that answers like it."""
