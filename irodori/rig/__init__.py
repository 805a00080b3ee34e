"""The rig: what moves the camera and the table, what takes the photographs, and the session that brings both together.

``devices`` states what a rig and a camera must do. Real ones and simulated ones are peers behind these contracts;
``virtual`` holds the camera that computes its photographs. Nothing after the capture imports this package; only the
report reads the virtual rig's ground truth.
"""
