"""Choice of the most informative poses for a material."""
