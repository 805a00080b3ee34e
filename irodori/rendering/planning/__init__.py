"""What a scene needs modelled within a tolerance, decided, predicted and checked [design, §2]."""
