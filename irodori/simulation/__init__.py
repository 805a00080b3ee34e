"""Simulated hardware: a virtual rig and camera that write RAW files, and simulated motion controllers."""
