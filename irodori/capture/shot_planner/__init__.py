"""Choice of the poses that tell most about a material."""
