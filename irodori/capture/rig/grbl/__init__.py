"""Grbl 1.1, an open motion firmware, and its relatives grblHAL and FluidNC: their protocol and the rig driver."""
