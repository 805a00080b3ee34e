"""The virtual rig: a gonio-reflectance rig and camera in the computer, down to genuine DNG files.

Nothing after the capture imports this package; only the report reads its ground truth.
"""
