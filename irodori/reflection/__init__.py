"""Reflection models: Fresnel reflectance and the lobes of rough gloss."""
