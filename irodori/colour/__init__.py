"""Tristimulus values, chromatic adaptation, displays and their ICC profiles."""
