"""Definitions and capture table of a first project, made from a folder of photographs."""
