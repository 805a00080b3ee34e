"""Cameras on a USB cable, through gphoto2."""
