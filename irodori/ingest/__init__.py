"""RAW ingestion: linear responses from the files of a camera.

A superpixel is made of 2 x 2 mosaic pixels and has red, the mean of the two greens, and blue; nothing is interpolated.
The bands are red, green and blue without the filter, followed by those with the filter if it was used.
"""
