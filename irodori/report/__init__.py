"""Report pages: pictures, maps, and errors against ground truth where it is known."""
