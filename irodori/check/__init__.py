"""Checks of a whole project before any long job."""
