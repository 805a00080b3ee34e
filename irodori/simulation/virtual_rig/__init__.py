"""The virtual camera: it computes what a real one would photograph on the rig, down to genuine DNG files."""
