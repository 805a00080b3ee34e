"""RAW ingestion: linear responses from a camera's files.

A superpixel is 2 x 2 mosaic pixels: red, the mean of the two greens, blue; nothing is interpolated. Bands are red,
green, blue without the filter, then with it where it was used; their number comes from the shots, not from the code.
"""
