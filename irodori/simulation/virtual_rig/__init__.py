"""Virtual rig and camera: computed photographs as genuine DNG files."""
