"""Registration of two pictures of one object, taken without and with a comb-filter plate before the lens."""
