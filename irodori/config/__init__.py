"""Schemas, definitions and the checks between them, without heavy imports."""
