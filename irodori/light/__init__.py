"""Light from all directions: recovery, irradiance, blurred light and sampling."""
