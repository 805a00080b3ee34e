"""Schemas, definitions and the checks between them. Light enough for the Snakefile to import."""
