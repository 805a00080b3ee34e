"""Scene planning: the simplified model of a scene with the least work within a colour tolerance [design, §2]."""
