"""Light from all directions: recovery of spectra, irradiance, and blurred light for gloss."""
