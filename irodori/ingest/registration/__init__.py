"""Sub-pixel registration of two shots of one object, without and with a filter plate in front of the lens."""
