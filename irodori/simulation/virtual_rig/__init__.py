"""Virtual rig and camera: computed photographs, written as DNG files that any RAW converter reads."""
