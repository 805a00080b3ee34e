"""Drivers of motorised rigs."""
