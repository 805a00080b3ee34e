"""Configuration checks across files, beyond what a schema can express.

`definitions` goes through all of them; each other module holds what concerns one kind of thing.
"""
