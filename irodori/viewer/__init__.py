"""The classroom page: a scene in one file that opens in a browser without a network."""
