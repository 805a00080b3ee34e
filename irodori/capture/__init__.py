"""Capture sessions: the rig, its camera, the person at the bench and the journal."""
