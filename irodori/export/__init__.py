"""Pictures and material maps for other programs."""
