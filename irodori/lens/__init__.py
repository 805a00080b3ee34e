"""Calibration of a lens from photographs of a printed sheet: focal length, principal point, distortion."""
