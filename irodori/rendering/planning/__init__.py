"""Scene planning: the cheapest model of a scene within a colour tolerance [design, §2]."""
