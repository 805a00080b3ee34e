"""Simulated hardware: a virtual rig that makes RAW files, and motion controllers."""
